//! Holds lights at green for the tasks before the cross task.

use std::collections::BTreeMap;
use sumo_network::network::{Route, TrafficLightId};
use sumo_traci::{Batch, traffic_light};
use wad_sim::bridge::{Bridge, BridgeError};

/// Held lights, with their own programs.
#[derive(Debug, Default)]
pub struct Held(Vec<(TrafficLightId, String)>);

impl Held {
    /// The held lights.
    pub fn lights(&self) -> impl Iterator<Item = TrafficLightId> {
        self.0.iter().map(|(light, _)| *light)
    }
}

/// Holds every light on `route` at green for the route and at red for all others, from the next step on. Lights
/// that are `taken`, held for another ego, stay as they are.
pub async fn hold(bridge: &mut Bridge, route: &Route, taken: &[TrafficLightId]) -> Result<Held, BridgeError> {
    let network = bridge.network().clone();
    let mut states: BTreeMap<u32, Vec<u8>> = BTreeMap::new();
    let signals = route.links.iter().filter_map(|link| network.link(link.link).signal);
    for signal in signals.filter(|signal| !taken.contains(&signal.traffic_light)) {
        let light = network.traffic_light(signal.traffic_light);
        let state = states.entry(signal.traffic_light.0).or_insert_with(|| vec![b'r'; light.signals]);
        if let Some(head) = state.get_mut(signal.index) {
            *head = b'G';
        }
    }
    if states.is_empty() {
        return Ok(Held::default());
    }
    let id = |light: u32| network.traffic_light(TrafficLightId(light)).id.as_str();
    let mut batch = Batch::new();
    let asked: Vec<_> =
        states.keys().map(|&light| (light, batch.get(traffic_light::PROGRAM, id(light)))).collect();
    let replies = bridge.client_mut().send(&batch).await?;
    let mut held = Held::default();
    for (light, program) in asked {
        held.0.push((TrafficLightId(light), replies.get(program).map_err(sumo_traci::Error::from)?));
    }
    for (&light, state) in &states {
        let state = String::from_utf8_lossy(state);
        bridge.next_batch().set(traffic_light::SET_STATE, id(light), &*state);
    }
    Ok(held)
}

/// Restores the lights' programs, from the next step on.
pub fn release(bridge: &mut Bridge, held: &mut Held) {
    let network = bridge.network().clone();
    for (light, program) in held.0.drain(..) {
        let id = &network.traffic_light(light).id;
        bridge.next_batch().set(traffic_light::SET_PROGRAM, id, program.as_str());
    }
}
