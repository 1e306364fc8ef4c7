//! Right of way: the junctions' request matrices, applied to links and crossings.
//!
//! SUMO numbers a junction's links in the order of its incoming lanes (`incLanes`) and, for each
//! lane, of its connections in the file; ways from a walkingarea onto a crossing count too and so
//! come last. In `response` and `foes` link 0 is the last character.

use super::parse::{RawJunction, RawNet};
use super::source::Source;
use super::*;
use std::collections::HashMap;

#[derive(Clone, Copy)]
enum Slot {
    Link(LinkId),
    Crossing(CrossingId),
}

/// Fills the links' request index, `must_yield_to`, `foes`, `crossings` and `yields_to_crossings`.
pub(super) fn apply(network: &mut Network, raw: &RawNet, source: &Source<'_>) -> Result<(), NetworkError> {
    let entries = crossing_entries(network, raw);
    for junction in raw.junctions.iter().filter(|j| j.kind != "internal") {
        let slots = slots(network, junction, &entries, source)?;
        for (index, slot) in slots.iter().enumerate() {
            if let Slot::Link(link) = slot {
                network.links[link.index()].request_index = Some(index);
            }
        }
        for request in &junction.requests {
            let Some(Slot::Link(link)) = slots.get(request.index).copied() else { continue };
            for (index, slot) in slots.iter().enumerate() {
                let (response, foe) = (bit(&request.response, index), bit(&request.foes, index));
                let link = &mut network.links[link.index()];
                match *slot {
                    Slot::Link(other) => {
                        if response {
                            link.must_yield_to.push(other);
                        }
                        if foe {
                            link.foes.push(other);
                        }
                    }
                    Slot::Crossing(crossing) => {
                        if response {
                            link.yields_to_crossings.push(crossing);
                            network.crossings[crossing.index()].priority = true;
                        }
                        if foe {
                            link.crossings.push(crossing);
                        }
                    }
                }
            }
        }
    }
    cut_crossings(network);
    Ok(())
}

/// Character `index` of a bit string, counted from the right.
fn bit(text: &str, index: usize) -> bool {
    let bytes = text.as_bytes();
    bytes.len().checked_sub(index + 1).is_some_and(|i| bytes[i] == b'1')
}

/// For each walkingarea lane the crossings that one enters from it, in the file's order.
fn crossing_entries(network: &Network, raw: &RawNet) -> HashMap<LaneId, Vec<CrossingId>> {
    let by_edge: HashMap<&str, CrossingId> = network
        .crossings
        .iter()
        .enumerate()
        .map(|(i, c)| (network.edge(c.edge).id.as_str(), CrossingId(i as u32)))
        .collect();
    let mut entries: HashMap<LaneId, Vec<CrossingId>> = HashMap::new();
    for connection in &raw.connections {
        let Some(&crossing) = by_edge.get(connection.to.as_str()) else { continue };
        let from = network.names.edges.get(&connection.from).map(|&e| network.edge(e));
        if let Some(&lane) = from.and_then(|e| e.lanes.get(connection.from_lane)) {
            entries.entry(lane).or_default().push(crossing);
        }
    }
    entries
}

fn slots(
    network: &Network,
    junction: &RawJunction,
    entries: &HashMap<LaneId, Vec<CrossingId>>,
    source: &Source<'_>,
) -> Result<Vec<Slot>, NetworkError> {
    let mut slots = Vec::with_capacity(junction.requests.len());
    for name in &junction.incoming_lanes {
        let Some(&lane) = network.names.lanes.get(name) else {
            return Err(source.no_lane(junction.position, name));
        };
        slots.extend(network.lane(lane).outgoing.iter().map(|&link| Slot::Link(link)));
        if let Some(crossings) = entries.get(&lane) {
            slots.extend(crossings.iter().map(|&c| Slot::Crossing(c)));
        }
    }
    Ok(slots)
}

/// Adds the crossings that a link's path cuts though the request matrix is silent.
fn cut_crossings(network: &mut Network) {
    for index in 0..network.links.len() {
        let link = &network.links[index];
        let candidates = &network.junction(link.junction).crossings;
        let mut found = Vec::new();
        for &crossing in candidates.iter().filter(|c| !link.crossings.contains(c)) {
            let line = &network.lane(network.crossing(crossing).lane).shape;
            if link.via.iter().any(|&lane| intersect(&network.lane(lane).shape, line)) {
                found.push(crossing);
            }
        }
        network.links[index].crossings.extend(found);
    }
}

/// Whether two lines cross in the plane.
fn intersect(a: &Polyline, b: &Polyline) -> bool {
    a.points().windows(2).any(|p| {
        b.points().windows(2).any(|q| {
            let (r, s) = (p[1].xy() - p[0].xy(), q[1].xy() - q[0].xy());
            let cross = r.perp(&s);
            let between = q[0].xy() - p[0].xy();
            let (t, u) = (between.perp(&s) / cross, between.perp(&r) / cross);
            cross.abs() > 1e-9 && (0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)
        })
    })
}
