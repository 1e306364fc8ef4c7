//! Requests about background traffic: its size, and whether a place is free.

use super::{Bridge, BridgeError};
use crate::traffic::{self, Counts, Population};
use std::sync::Arc;
use sumo_network::geometry::Point;
use sumo_network::network::{LaneId, Network};
use sumo_traci::{Batch, RemoveReason, person, vehicle};

impl Bridge {
    /// Never removes the vehicle `id`, which the caller adds, until [`Bridge::remove`].
    pub fn keep(&mut self, id: &str) {
        self.guests.insert(id.to_string(), false);
        if let Some(population) = &mut self.population {
            population.keep(id);
        }
    }

    /// Removes the vehicle `id`, which is kept, with the next step.
    pub fn remove(&mut self, id: &str) {
        vehicle::remove(&mut self.batch, id, RemoveReason::Vaporized);
        self.taken_out += usize::from(self.guests.remove(id) == Some(true));
    }

    /// Keeps `counts` of background traffic alive from now on; see [`Population::resize`]. False if
    /// the traffic is the config's own.
    pub fn resize_traffic(&mut self, counts: Counts) -> bool {
        let Some(population) = &mut self.population else { return false };
        if population.wanted() != counts {
            population.resize(counts, &mut self.batch);
        }
        true
    }

    /// The same for any population: the next step replaces the config's own traffic by a population that is
    /// kept alive.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn set_traffic(&mut self, counts: Counts) -> Result<(), BridgeError> {
        if self.resize_traffic(counts) {
            return Ok(());
        }
        let mut ask = Batch::new();
        let (vehicles, persons) = (ask.get(vehicle::ID_LIST, ""), ask.get(person::ID_LIST, ""));
        let replies = self.ask(&ask).await?;
        let mut population =
            population_of(&self.traffic_roads, Counts::default(), self.traffic_seed, self.traffic_alone);
        self.egos.iter().chain(self.guests.keys()).for_each(|id| population.keep(id));
        for id in replies.get(vehicles).map_err(sumo_traci::Error::from)? {
            if self.traffic_alone && !self.guests.contains_key(&id) && !self.egos.contains(&id) {
                vehicle::remove(&mut self.batch, &id, RemoveReason::Vaporized);
                self.taken_out += 1;
            }
        }
        let persons = replies.get(persons).map_err(sumo_traci::Error::from)?;
        for id in persons.into_iter().filter(|_| self.traffic_alone) {
            person::remove(&mut self.batch, &id, RemoveReason::Vaporized);
        }
        // They come with the next updates, out of the ego's sight.
        population.resize(counts, &mut self.batch);
        self.population = Some(population);
        Ok(())
    }

    /// Removes background vehicles within `radius` (m) of `place` with the next step; they come back
    /// elsewhere. Checks `lanes` only. False if a vehicle stays, because it is not the population's.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn clear(&mut self, place: Point, radius: f64, lanes: &[LaneId]) -> Result<bool, BridgeError> {
        let mut batch = Batch::new();
        let tickets: Vec<_> = lanes
            .iter()
            .map(|lane| batch.get(sumo_traci::lane::LAST_STEP_VEHICLE_IDS, &self.network.lane(*lane).id))
            .collect();
        let replies = self.ask(&batch).await?;
        let mut ids: Vec<String> = Vec::new();
        for ticket in tickets {
            ids.extend(replies.get(ticket).map_err(sumo_traci::Error::from)?);
        }
        ids.retain(|id| !self.egos.contains(id));
        ids.sort_unstable();
        ids.dedup();
        if ids.is_empty() {
            return Ok(true);
        }
        let mut batch = Batch::new();
        let tickets: Vec<_> = ids.iter().map(|id| batch.get(vehicle::POSITION, id)).collect();
        let replies = self.ask(&batch).await?;
        let near = ids.iter().zip(tickets).filter(|(_, ticket)| {
            let position = replies.get(*ticket);
            position.is_ok_and(|p| (Point::new(p.x, p.y) - place).norm() < radius)
        });
        let mut all = true;
        for (id, _) in near {
            match &mut self.population {
                Some(population) if population.owns(id) => {
                    population.evict([id.as_str()], &mut self.batch);
                }
                _ => all = false,
            }
        }
        Ok(all)
    }
}

pub(super) fn population_of(network: &Arc<Network>, counts: Counts, seed: u64, alone: bool) -> Population {
    let behaviour = traffic::Options { alone, ..Default::default() };
    Population::new(Arc::clone(network), counts, seed, behaviour)
}
