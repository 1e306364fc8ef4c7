//! Departures and arrivals of a step.

use sumo_traci::simulation::{self, Simulation};
use sumo_traci::subscription::Subscribed;
use sumo_traci::{Batch, CommandError, Replies, Ticket, VariableId};

/// SUMO's departures and arrivals of the last step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepEvents<'a> {
    /// Simulation time after the step (s).
    pub time: f64,
    /// Vehicles that departed.
    pub departed: Vec<&'a str>,
    /// Vehicles that arrived.
    pub arrived: Vec<&'a str>,
    /// Persons who departed.
    pub departed_persons: Vec<&'a str>,
    /// Persons who arrived.
    pub arrived_persons: Vec<&'a str>,
}

impl<'a> StepEvents<'a> {
    /// The simulation's variables that [`StepEvents::read`] needs.
    ///
    /// SUMO keeps one subscription to the simulation: a caller with variables of its own
    /// subscribes once to both lists.
    pub fn variables() -> [VariableId<'static, Simulation>; 5] {
        [
            simulation::TIME.id(),
            simulation::DEPARTED_IDS.id(),
            simulation::ARRIVED_IDS.id(),
            simulation::DEPARTED_PERSON_IDS.id(),
            simulation::ARRIVED_PERSON_IDS.id(),
        ]
    }

    /// Subscribes to them for the whole run.
    pub fn subscribe(batch: &mut Batch) -> Ticket<Subscribed> {
        batch.subscribe(Simulation, "", &Self::variables())
    }

    /// Reads the subscription's results of a step.
    ///
    /// # Errors
    /// The variables were not subscribed to.
    pub fn read(replies: &'a Replies) -> Result<Self, CommandError> {
        let Some(results) = replies.subscriptions().object(Simulation, "") else {
            return Err(CommandError {
                command: "reading departures and arrivals".to_owned(),
                object: String::new(),
                message: "expected the simulation's subscription with the step, found none: call \
                          Population::subscribe once after connecting"
                    .to_owned(),
            });
        };
        let time = results.value(simulation::TIME)?;
        let departed = results.value_ref(simulation::DEPARTED_IDS)?.collect();
        let arrived = results.value_ref(simulation::ARRIVED_IDS)?.collect();
        let departed_persons = results.value_ref(simulation::DEPARTED_PERSON_IDS)?.collect();
        let arrived_persons = results.value_ref(simulation::ARRIVED_PERSON_IDS)?.collect();
        Ok(Self { time, departed, arrived, departed_persons, arrived_persons })
    }
}
