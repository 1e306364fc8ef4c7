//! Watches the traffic lights near the ego and no others, so that the cost does not grow with the town.

use std::sync::Arc;
use sumo_network::geometry::Point;
use sumo_network::network::{Network, TrafficLightId};
use sumo_traci::{Batch, Subscriptions, traffic_light};

/// The subscriptions to traffic lights, and what they show.
#[derive(Debug)]
pub struct SignalWatch {
    watched: Vec<TrafficLightId>,
    states: Vec<Option<Arc<str>>>,
    sight: f64,
    /// Where the subscriptions were last updated.
    last: Option<Vec<Point>>,
}

/// How far an observer moves before the subscriptions are updated (m), and how much farther away than that a
/// light is kept, so that none flickers in and out.
const MOVED: f64 = 10.0;
const KEEP: f64 = 30.0;

impl SignalWatch {
    /// Watches lights within `sight` (m) of each observer.
    pub fn new(network: &Network, sight: f64) -> Self {
        Self { watched: Vec::new(), states: vec![None; network.traffic_lights.len()], sight, last: None }
    }

    /// State strings by traffic light, None where out of sight.
    pub fn states(&self) -> &[Option<Arc<str>>] {
        &self.states
    }

    /// Appends the changes of subscriptions that observers at these places need.
    pub fn follow(&mut self, network: &Network, observers: &[Point], batch: &mut Batch) {
        let near = |last: &Vec<Point>| {
            last.len() == observers.len() && last.iter().zip(observers).all(|(a, b)| (a - b).norm() < MOVED)
        };
        if self.last.as_ref().is_some_and(near) {
            return;
        }
        self.last = Some(observers.to_vec());
        for (index, light) in network.traffic_lights.iter().enumerate() {
            let id = TrafficLightId(index as u32);
            let distance = observers
                .iter()
                .map(|observer| (observer - light.position).norm() - light.radius)
                .fold(f64::INFINITY, f64::min);
            let watched = self.watched.contains(&id);
            if !watched && distance < self.sight + MOVED {
                batch.subscribe(traffic_light::TrafficLight, &light.id, &[traffic_light::STATE.id()]);
                self.watched.push(id);
            } else if watched && distance > self.sight + KEEP {
                batch.unsubscribe(traffic_light::TrafficLight, &light.id);
                self.watched.retain(|other| *other != id);
                self.states[index] = None;
            }
        }
    }

    /// Reads what came with a step.
    pub fn read(&mut self, network: &Network, subscriptions: &Subscriptions<'_>) {
        for object in subscriptions.objects(traffic_light::TrafficLight) {
            let Some(id) = network.traffic_light_by_id(object.id()) else { continue };
            let Ok(state) = object.str(traffic_light::STATE) else { continue };
            let slot = &mut self.states[id.index()];
            if slot.as_deref() != Some(state) && self.watched.contains(&id) {
                *slot = Some(Arc::from(state));
            }
        }
    }
}
