//! Adds signals, sidewalks and crossings to a net that has none. Its lanes stay on their lines.

use super::restore::{Moved, compare, restore};
use super::{NetError, arguments, run};
use serde::Serialize;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::Path;
use sumo_network::network::{EdgeKind, Junction, Network, VehicleClass};
use sumo_traci::process::SumoInstall;

/// What to add.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Traffic lights.
    pub signals: bool,
    /// Sidewalks.
    pub sidewalks: bool,
    /// Pedestrian crossings.
    pub crossings: bool,
}

/// What was added.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Enriched {
    /// Traffic lights before and after.
    pub signals: (usize, usize),
    /// Lanes for pedestrians alone, before and after.
    pub sidewalks: (usize, usize),
    /// Pedestrian crossings before and after.
    pub crossings: (usize, usize),
    /// Signals of the old net that netconvert dropped, by id: most control no traffic.
    pub dropped_signals: Vec<String>,
    /// Lanes that netconvert moved and that were put back.
    pub put_back: usize,
    /// The lanes compared with the old net: none is off its line.
    pub moved: Moved,
}

/// Lanes for pedestrians alone.
pub fn sidewalks(network: &Network) -> usize {
    let sidewalk = |lane: &&sumo_network::network::Lane| {
        network.edge(lane.edge).kind == EdgeKind::Normal
            && lane.permissions.allows(VehicleClass::Pedestrian)
            && !lane.permissions.allows(VehicleClass::Passenger)
    };
    network.lanes.iter().filter(sidewalk).count()
}

impl Wanted {
    /// The elements that a net lacks.
    pub fn missing(network: &Network) -> Self {
        Self {
            signals: network.traffic_lights.is_empty(),
            sidewalks: sidewalks(network) == 0,
            crossings: network.crossings.is_empty(),
        }
    }
}

/// Fastest road that gets a sidewalk (m/s): 70 km/h.
const TOWN: f64 = 19.5;

/// Writes the net of `from` with what is `wanted` to `to`.
///
/// # Errors
/// netconvert fails, a lane would leave its line, or SUMO cannot read the new net; nothing is written then.
pub fn enrich(from: &Path, to: &Path, wanted: Wanted) -> Result<Enriched, NetError> {
    let install = SumoInstall::find()?;
    let old = Network::load(from)?;
    let mut given: Vec<OsString> = vec!["--sumo-net-file".into(), from.into()];
    // As the net was, but for what is added.
    given.extend(arguments(&[("offset.disable-normalization", "true"), ("no-turnarounds.tls", "true")]));
    if wanted.sidewalks {
        let top = format!("{TOWN}");
        given.extend(arguments(&[
            ("sidewalks.guess", "true"),
            ("sidewalks.guess.min-speed", "2"),
            ("sidewalks.guess.max-speed", &top),
        ]));
    }
    if wanted.crossings {
        given.extend(arguments(&[("crossings.guess", "true"), ("crossings.guess.speed-threshold", "19.5")]));
    }
    if wanted.sidewalks || wanted.crossings {
        given.extend(arguments(&[("walkingareas", "true")]));
    }
    let signalled = if wanted.signals { busy_junctions(&old) } else { Vec::new() };
    if !signalled.is_empty() {
        given.extend(arguments(&[("tls.set", &signalled.join(",")), ("tls.default-type", "static")]));
    }
    let scratch = tempfile::Builder::new()
        .prefix("wad-net-")
        .tempdir()
        .map_err(|source| NetError::Write { path: std::env::temp_dir(), source })?;
    let raw = scratch.path().join("raw.net.xml");
    given.extend([OsString::from("--output-file"), raw.clone().into()]);
    run(&install, "netconvert", from, given)?;
    let text =
        std::fs::read_to_string(&raw).map_err(|source| NetError::Read { path: raw.clone(), source })?;
    let built = Network::load(&raw)?;
    let (text, put_back) = restore(&raw, &text, &old, &built)?;
    let new = Network::from_xml(to, &text)?;
    let moved = compare(&old, &new);
    if moved.lanes > 0 || moved.missing > 0 {
        return Err(NetError::Moved(moved));
    }
    // Before anything is left behind: SUMO reads it.
    let made = scratch.path().join("made.net.xml");
    std::fs::write(&made, &text).map_err(|source| NetError::Write { path: made.clone(), source })?;
    let mut given: Vec<OsString> = vec!["--net-file".into(), made.into()];
    given.extend(arguments(&[("end", "1"), ("no-step-log", "true")]));
    run(&install, "sumo", from, given)?;
    std::fs::write(to, text).map_err(|source| NetError::Write { path: to.to_path_buf(), source })?;
    Ok(Enriched {
        signals: (old.traffic_lights.len(), new.traffic_lights.len()),
        sidewalks: (sidewalks(&old), sidewalks(&new)),
        crossings: (old.crossings.len(), new.crossings.len()),
        dropped_signals: dropped_signals(&old, &new),
        put_back,
        moved,
    })
}

fn dropped_signals(old: &Network, new: &Network) -> Vec<String> {
    let kept: BTreeSet<&str> = new.traffic_lights.iter().map(|light| light.id.as_str()).collect();
    let ids = old.traffic_lights.iter().map(|light| light.id.as_str());
    ids.filter(|id| !kept.contains(id)).map(str::to_string).collect()
}

/// Junctions that a town would signal: four arms for cars, or three of which one is wide or fast.
fn busy_junctions(network: &Network) -> Vec<String> {
    let ring: BTreeSet<_> = network.roundabouts.iter().flatten().collect();
    let busy = |junction: &&Junction| {
        let lanes = |edge: &sumo_network::network::EdgeId| {
            let open = |lane: &&sumo_network::network::LaneId| {
                network.lane(**lane).permissions.allows(VehicleClass::Passenger)
            };
            network.edge(*edge).lanes.iter().filter(open).count()
        };
        let arms: Vec<_> = junction.incoming_edges.iter().filter(|e| lanes(e) > 0).collect();
        let round = arms.iter().any(|edge| ring.contains(*edge));
        let fast = |edge: &&sumo_network::network::EdgeId| {
            network.edge(**edge).lanes.iter().any(|l| network.lane(*l).speed_limit > 13.0) && lanes(edge) > 1
        };
        let plain = matches!(
            junction.kind.as_str(),
            "priority"
                | "right_before_left"
                | "left_before_right"
                | "allway_stop"
                | "priority_stop"
                | "unregulated"
        );
        plain && !round && (arms.len() >= 4 || arms.len() == 3 && arms.iter().any(fast))
    };
    network.junctions.iter().filter(busy).map(|j| j.id.clone()).collect()
}
