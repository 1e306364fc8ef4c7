//! From the file's elements to the network: names become ids, connections become links.

use super::parse::{RawConnection, RawEdge, RawNet, parse};
use super::requests;
use super::source::Source;
use super::spatial::LaneTree;
use super::xml::read_text;
use super::*;
use crate::geometry::Vector;
use std::collections::HashMap;
use std::path::Path;

/// Width of a lane (m) where the file gives none.
const DEFAULT_LANE_WIDTH: f64 = 3.2;
/// A signal index beyond this is taken for damage.
const MOST_SIGNALS: usize = 100_000;

impl Network {
    /// Reads a `.net.xml` or `.net.xml.gz` file.
    ///
    /// # Errors
    /// The file cannot be read, is not XML, is not a network, is cut off, or names an element that it lacks.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        Self::from_xml(path, &read_text(path)?)
    }

    /// The network of a `.net.xml` document; `path` is what errors call it.
    ///
    /// # Errors
    /// As [`Network::load`].
    pub fn from_xml(path: &Path, text: &str) -> Result<Self, NetworkError> {
        build(parse(path, text)?, &Source { path, text })
    }
}

/// Builds the network from its parts.
fn build(raw: RawNet, source: &Source<'_>) -> Result<Network, NetworkError> {
    let mut network = Network {
        edges: Vec::with_capacity(raw.edges.len()),
        lanes: Vec::new(),
        junctions: Vec::new(),
        links: Vec::new(),
        crossings: Vec::new(),
        traffic_lights: Vec::new(),
        roundabouts: Vec::new(),
        left_hand: raw.left_hand,
        bounds: (Point::origin(), Point::origin()),
        names: Names::default(),
        tree: LaneTree::default(),
        drivable: Vec::new(),
        walks: PedestrianNetwork::default(),
    };
    junctions(&mut network, &raw);
    edges(&mut network, &raw, source)?;
    crossings(&mut network, &raw);
    for light in &raw.traffic_lights {
        let id = traffic_light(&mut network, &light.id);
        let known = &mut network.traffic_lights[id.index()];
        known.signals = light.signals.max(known.signals);
        known.programs.push(light.program.clone());
    }
    links(&mut network, &raw, source)?;
    requests::apply(&mut network, &raw, source)?;
    let rings = raw.roundabouts.iter();
    network.roundabouts =
        rings.map(|ring| ring.iter().filter_map(|id| network.edge_by_id(id)).collect()).collect();
    traffic_light_places(&mut network);
    network.bounds = bounds(&network);
    network.tree = LaneTree::new(&network.edges, &network.lanes);
    network.drivable = VehicleClass::EVERY.iter().map(|&class| drivable(&network, class)).collect();
    network.walks = {
        let (edges, lanes) = (&network.edges, &network.lanes);
        PedestrianNetwork::new(edges, lanes, &network.names.edges, &raw.connections)
    };
    Ok(network)
}

fn junctions(network: &mut Network, raw: &RawNet) {
    for junction in raw.junctions.iter().filter(|j| j.kind != "internal") {
        let id = JunctionId(network.junctions.len() as u32);
        if network.names.junctions.contains_key(&junction.id) {
            continue;
        }
        network.names.junctions.insert(junction.id.clone(), id);
        network.junctions.push(Junction {
            id: junction.id.clone(),
            kind: junction.kind.clone(),
            position: junction.point.xy(),
            shape: junction.shape.iter().map(|p| p.xy()).collect(),
            incoming_edges: Vec::new(),
            outgoing_edges: Vec::new(),
            crossings: Vec::new(),
            walkingareas: Vec::new(),
        });
    }
}

fn kind_of(edge: &RawEdge) -> EdgeKind {
    match edge.function.as_str() {
        "internal" => EdgeKind::Internal,
        "crossing" => EdgeKind::Crossing,
        "walkingarea" => EdgeKind::WalkingArea,
        "" | "normal" if edge.id.starts_with(':') => EdgeKind::Internal,
        "" | "normal" => EdgeKind::Normal,
        _ => EdgeKind::Other,
    }
}

fn edges(network: &mut Network, raw: &RawNet, source: &Source<'_>) -> Result<(), NetworkError> {
    for edge in &raw.edges {
        if network.names.edges.contains_key(&edge.id) {
            continue;
        }
        let id = EdgeId(network.edges.len() as u32);
        let kind = kind_of(edge);
        let road = matches!(kind, EdgeKind::Normal | EdgeKind::Other);
        let end = |name: &Option<String>| match name {
            Some(name) if road => match network.names.junctions.get(name) {
                Some(&junction) => Ok(Some(junction)),
                None => Err(source.dangling(edge.position, "edge", "junction", name)),
            },
            _ => Ok(None),
        };
        let (from, to) = (end(&edge.from)?, end(&edge.to)?);
        // `:JUNCTION_3`: an inner edge is named after its junction.
        let owner = edge.id.strip_prefix(':').and_then(|rest| rest.rsplit_once('_'));
        let junction =
            owner.filter(|_| !road).and_then(|(name, _)| network.names.junctions.get(name).copied());
        let mut lanes = Vec::with_capacity(edge.lanes.len());
        for (index, lane) in edge.lanes.iter().enumerate() {
            let lane_id = LaneId(network.lanes.len() as u32);
            network.names.lanes.entry(lane.id.clone()).or_insert(lane_id);
            lanes.push(lane_id);
            network.lanes.push(Lane {
                id: lane.id.clone(),
                edge: id,
                index,
                speed_limit: lane.speed,
                length: lane.length,
                width: lane.width.unwrap_or(DEFAULT_LANE_WIDTH),
                permissions: lane.permissions,
                change_up: lane.change_left,
                change_down: lane.change_right,
                shape: Polyline::new(lane.shape.iter().copied()),
                outgoing: Vec::new(),
                incoming: Vec::new(),
            });
        }
        if let Some(from) = from {
            network.junctions[from.index()].outgoing_edges.push(id);
        }
        if let Some(to) = to {
            network.junctions[to.index()].incoming_edges.push(id);
        }
        if let (EdgeKind::WalkingArea, Some(junction)) = (kind, junction) {
            network.junctions[junction.index()].walkingareas.extend(&lanes);
        }
        network.names.edges.insert(edge.id.clone(), id);
        network.edges.push(Edge {
            id: edge.id.clone(),
            kind,
            from,
            to,
            junction,
            priority: edge.priority,
            edge_type: edge.edge_type.clone(),
            name: edge.name.clone(),
            lanes,
        });
    }
    Ok(())
}

fn crossings(network: &mut Network, raw: &RawNet) {
    for edge in raw.edges.iter().filter(|e| kind_of(e) == EdgeKind::Crossing) {
        let Some(&edge_id) = network.names.edges.get(&edge.id) else { continue };
        let Edge { junction: Some(junction), ref lanes, .. } = network.edges[edge_id.index()] else {
            continue;
        };
        let (Some(&lane), Some(raw_lane)) = (lanes.first(), edge.lanes.first()) else { continue };
        let id = CrossingId(network.crossings.len() as u32);
        let outline = if raw_lane.outline.len() >= 3 {
            raw_lane.outline.iter().map(|p| p.xy()).collect()
        } else {
            band(&network.lanes[lane.index()])
        };
        network.junctions[junction.index()].crossings.push(id);
        network.crossings.push(Crossing {
            lane,
            edge: edge_id,
            junction,
            crossed_edges: edge
                .crossing_edges
                .iter()
                .filter_map(|e| network.names.edges.get(e).copied())
                .collect(),
            outline,
            signal: None,
            priority: false,
        });
    }
}

/// The outline of a lane: its shape made as wide as the lane.
fn band(lane: &Lane) -> Vec<Point> {
    let side = |offset: f64| {
        lane.shape.arc_lengths().iter().map(move |&s| lane.shape.at(s).to_world(Vector::new(0.0, offset)))
    };
    side(0.5 * lane.width).chain(side(-0.5 * lane.width).rev()).collect()
}

/// The traffic light of this id, made where it is new.
fn traffic_light(network: &mut Network, id: &str) -> TrafficLightId {
    if let Some(&known) = network.names.traffic_lights.get(id) {
        return known;
    }
    let new = TrafficLightId(network.traffic_lights.len() as u32);
    network.names.traffic_lights.insert(id.to_owned(), new);
    network.traffic_lights.push(TrafficLight {
        id: id.to_owned(),
        signals: 0,
        programs: Vec::new(),
        links: Vec::new(),
        crossings: Vec::new(),
        position: Point::origin(),
        radius: 0.0,
    });
    new
}

fn direction(letter: u8) -> LinkDirection {
    match letter {
        b's' => LinkDirection::Straight,
        b't' | b'T' => LinkDirection::TurnAround,
        b'l' => LinkDirection::Left,
        b'r' => LinkDirection::Right,
        b'L' => LinkDirection::PartLeft,
        b'R' => LinkDirection::PartRight,
        _ => LinkDirection::Invalid,
    }
}

fn links(network: &mut Network, raw: &RawNet, source: &Source<'_>) -> Result<(), NetworkError> {
    let edge = |network: &Network, c: &RawConnection, name: &str| {
        let edge = network.names.edges.get(name).copied();
        edge.ok_or_else(|| source.dangling(c.position, "connection", "edge", name))
    };
    let lane = |network: &Network, c: &RawConnection, edge: EdgeId, index: usize| {
        let edge = network.edge(edge);
        let lane = edge.lanes.get(index).copied();
        lane.ok_or_else(|| source.dangling(c.position, "connection", "lane", &format!("{}_{index}", edge.id)))
    };
    // Where an internal lane goes on inside its junction.
    let mut continued: HashMap<LaneId, LaneId> = HashMap::new();
    for connection in raw.connections.iter().filter(|c| c.from.starts_with(':')) {
        let from = edge(network, connection, &connection.from)?;
        let from = lane(network, connection, from, connection.from_lane)?;
        if let Some(via) = connection.via.as_ref().and_then(|v| network.names.lanes.get(v)) {
            continued.insert(from, *via);
        }
    }
    for connection in &raw.connections {
        let from_edge = edge(network, connection, &connection.from)?;
        let to_edge = edge(network, connection, &connection.to)?;
        let from = lane(network, connection, from_edge, connection.from_lane)?;
        let to = lane(network, connection, to_edge, connection.to_lane)?;
        let signal = match (&connection.traffic_light, connection.link_index) {
            (Some(name), Some(index)) if index < MOST_SIGNALS => {
                let traffic_light = traffic_light(network, name);
                let signals = &mut network.traffic_lights[traffic_light.index()].signals;
                *signals = (*signals).max(index + 1);
                Some(SignalIndex { traffic_light, index })
            }
            _ => None,
        };
        let kinds = (network.edge(from_edge).kind, network.edge(to_edge).kind);
        if kinds.1 == EdgeKind::Crossing {
            let crossing = network.crossings.iter().position(|c| c.edge == to_edge);
            if let Some(index) = crossing {
                let crossing = &mut network.crossings[index];
                crossing.priority |= matches!(connection.state, 'M' | 'O' | 'G');
                if let (Some(signal), None) = (signal, crossing.signal) {
                    crossing.signal = Some(signal);
                    let light = &mut network.traffic_lights[signal.traffic_light.index()];
                    light.crossings.push(CrossingId(index as u32));
                }
            }
            continue;
        }
        let road = |kind| matches!(kind, EdgeKind::Normal | EdgeKind::Other);
        let junction = network.edge(from_edge).to.or(network.edge(to_edge).from);
        let (true, true, Some(junction)) = (road(kinds.0), road(kinds.1), junction) else { continue };
        let mut via = Vec::new();
        if let Some(name) = &connection.via {
            let first = network.names.lanes.get(name).copied();
            let mut next =
                Some(first.ok_or_else(|| source.dangling(connection.position, "connection", "lane", name))?);
            while let Some(lane) = next.filter(|l| !via.contains(l)) {
                via.push(lane);
                next = continued.get(&lane).copied();
            }
        }
        let id = LinkId(network.links.len() as u32);
        network.lanes[from.index()].outgoing.push(id);
        network.lanes[to.index()].incoming.push(id);
        for lane in &via {
            network.lanes[lane.index()].incoming.push(id);
        }
        if let Some(signal) = signal {
            network.traffic_lights[signal.traffic_light.index()].links.push(id);
        }
        network.links.push(Link {
            from,
            to,
            via,
            direction: direction(connection.direction),
            state: connection.state,
            signal,
            junction,
            request_index: None,
            must_yield_to: Vec::new(),
            foes: Vec::new(),
            crossings: Vec::new(),
            yields_to_crossings: Vec::new(),
        });
    }
    Ok(())
}

/// Puts each traffic light in the middle of its stop lines.
fn traffic_light_places(network: &mut Network) {
    for i in 0..network.traffic_lights.len() {
        let light = &network.traffic_lights[i];
        let mut places: Vec<Point> = Vec::new();
        for &link in &light.links {
            let shape = &network.lane(network.link(link).from).shape;
            places.extend(shape.points().last().map(|p| p.xy()));
        }
        for &crossing in &light.crossings {
            let shape = &network.lane(network.crossing(crossing).lane).shape;
            places.extend(
                [shape.points().first(), shape.points().last()].into_iter().flatten().map(|p| p.xy()),
            );
        }
        if places.is_empty() {
            continue;
        }
        let sum = places.iter().fold(Vector::zeros(), |sum, p| sum + p.coords);
        let position = Point::from(sum / places.len() as f64);
        let radius = places.iter().map(|p| (p - position).norm()).fold(0.0, f64::max);
        let light = &mut network.traffic_lights[i];
        (light.position, light.radius) = (position, radius);
    }
}

fn bounds(network: &Network) -> (Point, Point) {
    let shapes = network.lanes.iter().flat_map(|l| l.shape.points().iter().map(|p| p.xy()));
    let mut points = shapes.chain(network.junctions.iter().flat_map(|j| j.shape.iter().copied()));
    let Some(first) = points.next() else { return (Point::origin(), Point::origin()) };
    points.fold((first, first), |(lo, hi), p| (lo.inf(&p), hi.sup(&p)))
}

fn drivable(network: &Network, class: VehicleClass) -> Vec<LaneId> {
    let lanes = (0..network.lanes.len() as u32).map(LaneId);
    lanes
        .filter(|&id| {
            let lane = network.lane(id);
            network.edge(lane.edge).kind == EdgeKind::Normal
                && lane.permissions.allows(class)
                && !lane.shape.is_degenerate()
        })
        .collect()
}
