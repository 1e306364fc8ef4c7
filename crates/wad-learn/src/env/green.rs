//! Holds lights at green for the tasks before the cross task.

use std::collections::BTreeMap;
use sumo_network::network::{EdgeId, Link, Network, Route, TrafficLightId};
use sumo_traci::{Batch, traffic_light};
use wad_sim::bridge::{Bridge, BridgeError};

/// The own programs of the lights that were held in a SUMO, which calls what a held one shows the program `online`.
pub type Programs = BTreeMap<TrafficLightId, String>;

/// Held lights, with their own programs.
#[derive(Debug, Default)]
pub struct Held(Vec<(TrafficLightId, String)>);

impl Held {
    /// The held lights.
    pub fn lights(&self) -> impl Iterator<Item = TrafficLightId> {
        self.0.iter().map(|(light, _)| *light)
    }
}

/// The states that hold every light on `route` at green for all ways out of the route's roads and at red for all others:
/// a head shows one lamp for all ways out of its lane, and the heads beside it show the same. Lights that are `taken`, held
/// for another ego, stay as they are.
fn states(network: &Network, route: &Route, taken: &[TrafficLightId]) -> BTreeMap<TrafficLightId, Vec<u8>> {
    let mut states: BTreeMap<TrafficLightId, Vec<u8>> = BTreeMap::new();
    let road = |link: &Link| network.lane(link.from).edge;
    let driven = route.links.iter().map(|link| network.link(link.link));
    let roads: Vec<EdgeId> = driven.filter(|link| link.signal.is_some()).map(road).collect();
    let out = network.links.iter().filter(|link| roads.contains(&road(link)));
    let signals = out.filter_map(|link| link.signal);
    for signal in signals.filter(|signal| !taken.contains(&signal.traffic_light)) {
        let light = network.traffic_light(signal.traffic_light);
        let state = states.entry(signal.traffic_light).or_insert_with(|| vec![b'r'; light.signals]);
        if let Some(head) = state.get_mut(signal.index) {
            *head = b'G';
        }
    }
    states
}

/// Holds the lights on `route` at green ([`states`]), from the next step on.
pub async fn hold(
    bridge: &mut Bridge,
    route: &Route,
    taken: &[TrafficLightId],
    programs: &mut Programs,
) -> Result<Held, BridgeError> {
    let network = bridge.network().clone();
    let states = states(&network, route, taken);
    let id = |light: TrafficLightId| network.traffic_light(light).id.as_str();
    let mut batch = Batch::new();
    let unknown = states.keys().filter(|light| !programs.contains_key(*light));
    let asked: Vec<_> = unknown.map(|&light| (light, batch.get(traffic_light::PROGRAM, id(light)))).collect();
    if !asked.is_empty() {
        let replies = bridge.ask(&batch).await?;
        for (light, program) in asked {
            programs.insert(light, replies.get(program).map_err(sumo_traci::Error::from)?);
        }
    }
    for (&light, state) in &states {
        let state = String::from_utf8_lossy(state);
        bridge.next_batch().set(traffic_light::SET_STATE, id(light), &*state);
    }
    Ok(Held(states.into_keys().map(|light| (light, programs[&light].clone())).collect()))
}

/// Restores the lights' programs, from the next step on.
pub fn release(bridge: &mut Bridge, held: &mut Held) {
    let network = bridge.network().clone();
    for (light, program) in held.0.drain(..) {
        let id = &network.traffic_light(light).id;
        bridge.next_batch().set(traffic_light::SET_PROGRAM, id, program.as_str());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::network::{LanePosition, VehicleClass};
    use wad_sim::bundled;

    #[test]
    fn all_ways_out_of_the_egos_lane_are_green_and_other_roads_wait() {
        let net = bundled::resolve("town3").unwrap().with_file_name("town3.net.xml");
        let network = Network::load(&net).unwrap();
        // A lane with several ways out, one of which is driven.
        let ways = |link: &Link| network.links.iter().filter(|other| other.from == link.from).count();
        let link = network.links.iter().find(|link| link.signal.is_some() && ways(link) > 2).unwrap();
        let [from, to] = [link.from, link.to].map(|lane| LanePosition { lane, s: 5.0 });
        let route = network.route(from, to, VehicleClass::Passenger).unwrap();
        let signal = link.signal.unwrap();
        let states = states(&network, &route, &[]);
        let held = &states[&signal.traffic_light];
        let shown = |link: &Link| held[link.signal.unwrap().index];
        let lights = |link: &&Link| link.signal.is_some_and(|s| s.traffic_light == signal.traffic_light);
        let road = network.lane(link.from).edge;
        let (own, others): (Vec<&Link>, Vec<&Link>) =
            network.links.iter().filter(lights).partition(|link| network.lane(link.from).edge == road);
        assert!(own.len() > 2 && own.iter().all(|link| shown(link) == b'G'));
        assert!(others.len() > 2 && others.iter().all(|link| shown(link) == b'r'));
        assert!(super::states(&network, &route, &[signal.traffic_light]).is_empty(), "held for another");
    }
}
