//! A collector with many egos in its SUMO.

use super::ongoing::{Chosen, Ongoing, Passed};
use super::{Collector, Stop, finite, lock};
use crate::agent::action;
use crate::env::{End, Fleet, Stages};
use crate::train::agent::schedule::Job;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use wad_see::observation::RAW_SIZE;
use wad_sim::session::Act;

/// Ticks of a fleet between two reports of its times.
const TOLD_EVERY: u64 = 50;

impl Collector<'_> {
    /// Drives a fleet until training is over. Validations are driven between its ticks, alone.
    pub(super) fn fly(&mut self) -> Result<(), Stop> {
        let egos = self.config.egos as usize;
        let dims = self.config.dims();
        let mut jobs = Vec::with_capacity(egos);
        for _ in 0..egos {
            jobs.push(self.next_training()?);
        }
        let encoders = jobs.iter().map(|job| self.encoder(job)).collect::<Result<_, _>>()?;
        let mut fleet = Fleet::new(Arc::clone(&self.maker.assets), self.config.env.clone(), encoders)?;
        self.told = Stages::default();
        let starts: Vec<_> = jobs.iter().map(|job| (job.task.clone(), job.seed)).collect();
        fleet.reset_each(&starts)?;
        let size = fleet.observation_size();
        let part = |fleet: &Fleet, ego: usize| {
            let (latent, raw) = fleet.observations()[ego * size..(ego + 1) * size].split_at(size - RAW_SIZE);
            dims.of_parts(latent, raw)
        };
        let mut ongoing: Vec<Option<Ongoing>> = Vec::with_capacity(egos);
        for (ego, job) in jobs.iter().enumerate() {
            ongoing.push(Some(Ongoing::new(job.clone(), self.config, finite(part(&fleet, ego))?)));
        }
        let mut acts = vec![Act::Stay; egos];
        let mut chosen: Vec<Chosen> = vec![Chosen::default(); egos];
        for tick in 1_u64.. {
            if self.shared.stop.load(Ordering::Relaxed) {
                return Err(Stop::Over);
            }
            for ego in 0..egos {
                let Some(ongoing) = &mut ongoing[ego] else { continue };
                let before = Chosen::before(fleet.ego(ego));
                let asks = ongoing.asks(self.config);
                let shown = if asks { Some(action::from_control(fleet.expert(ego)?)) } else { None };
                let action = self.choose(ongoing, shown, &fleet.eyes(ego).raw().vector())?;
                chosen[ego] = Chosen { action, shown, ..before };
                let control = action::to_control(action);
                acts[ego] = if asks { Act::Disturbed(control) } else { Act::Control(control) };
            }
            fleet.step(&acts)?;
            // One death, however many episodes it costs.
            let mut lost = None;
            for ego in 0..egos {
                let observation = part(&fleet, ego);
                let step = fleet.last();
                if step.began[ego] {
                    let job = jobs[ego].clone();
                    ongoing[ego] = Some(Ongoing::new(job, self.config, finite(observation)?));
                    continue;
                }
                let Some(one) = &mut ongoing[ego] else { continue };
                let result = Passed {
                    reward: step.rewards[ego],
                    terminated: step.terminated[ego],
                    truncated: step.truncated[ego],
                    info: &step.infos[ego],
                    tick: fleet.tick(),
                };
                let Some(report) = self.passed(one, chosen[ego], &result, observation)? else { continue };
                ongoing[ego] = None;
                if report.ending.end == End::Error {
                    lost = Some(report.ending.cause);
                } else {
                    self.tell(report)?;
                }
                jobs[ego] = self.next_training()?;
                fleet.set_next(ego, jobs[ego].task.clone(), jobs[ego].seed);
            }
            if let Some(cause) = lost {
                self.died(&cause)?;
            }
            if tick.is_multiple_of(TOLD_EVERY) {
                self.tell_times(Some(fleet.stages()));
            }
        }
        Ok(())
    }

    /// The next job of the training itself; validations before it are driven at once.
    fn next_training(&mut self) -> Result<Job, Stop> {
        loop {
            let job = self.next_job();
            if !job.purpose.validates() {
                return Ok(job);
            }
            self.drive_alone(&job)?;
            // Its SUMO is not needed until the next validation.
            if self.retry.is_none() && !lock(&self.shared.schedule).is_validating() {
                self.fresh = None;
            }
        }
    }
}
