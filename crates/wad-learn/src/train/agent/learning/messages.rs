//! What collectors send: experience, episodes, times.

use super::{Learning, Progress, TrainError, lock};
use crate::train::agent::collector::{Message, Shared};
use crate::train::agent::curve::StagePassed;
use crate::train::agent::schedule::{Purpose, Report};
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::Duration;
use tch::Tensor;
use wad_sim::tasks::Passed;

impl Learning<'_> {
    /// Receives from collectors; waits a little if there is nothing else to do.
    pub(super) fn listen(
        &mut self,
        messages: &Receiver<Message>,
        shared: &Shared,
        idle: bool,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        let mut message = if idle {
            match messages.recv_timeout(Duration::from_millis(50)) {
                Ok(message) => Some(message),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return Err(gone()),
            }
        } else {
            match messages.try_recv() {
                Ok(message) => Some(message),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => return Err(gone()),
            }
        };
        while let Some(now) = message.take() {
            match now {
                Message::Segment { segment, autopilot } => {
                    let n = segment.len() as u64;
                    if self.steps < self.config.steps {
                        self.buffer.push(&segment);
                        let mut schedule = lock(&shared.schedule);
                        if autopilot {
                            self.demonstrated += n;
                            schedule.state.demonstrated = self.demonstrated;
                        } else {
                            self.steps += n;
                            schedule.steps = self.steps;
                        }
                    }
                    // One segment at a time: the learner's turn.
                    return Ok(());
                }
                Message::Episode(report) => self.episode(*report, shared, progress)?,
                Message::Times(times) => {
                    let sum = &mut self.rate.env;
                    sum.steps += times.env.steps;
                    sum.sumo += times.env.sumo;
                    sum.physics += times.env.physics;
                    sum.camera += times.env.camera;
                    sum.perception += times.env.perception;
                    sum.encoder += times.env.encoder;
                    sum.resets += times.env.resets;
                    sum.reset += times.env.reset;
                    self.rate.actor += times.actor;
                    self.rate.waiting += times.waiting;
                }
                Message::Failed(error) => return Err(error),
            }
            message = messages.try_recv().ok();
        }
        Ok(())
    }

    /// What the critics expected of an episode's first action.
    fn expected(&self, report: &Report) -> Option<f64> {
        let (_, scale) = self.scale.as_ref().filter(|_| self.learner.updates() > 0)?;
        let (observation, action) = report.start.as_ref()?;
        let observation = Tensor::from_slice(observation).to_device(self.limits.device);
        Some(self.learner.value(&scale.apply(&observation), action) / self.config.reward_scale)
    }

    fn episode(
        &mut self,
        mut report: Report,
        shared: &Shared,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        match &report.purpose {
            Purpose::Validate(actor) => {
                let Some(validation) = &mut self.validation else { return Ok(()) };
                if actor.version == validation.actor.version {
                    validation.reports.push(report);
                }
                if validation.reports.len() >= validation.expected {
                    self.finish_validation(shared, progress)?;
                }
            }
            purpose => {
                let agent = !matches!(purpose, Purpose::Demonstrate { .. });
                let mut passed = None;
                let (stage, rate) = {
                    let mut schedule = lock(&shared.schedule);
                    let state = &mut schedule.state;
                    let curriculum = &self.config.curriculum;
                    if agent {
                        self.returns.push_back(report.episodic_return);
                        if self.returns.len() > 20 {
                            self.returns.pop_front();
                        }
                        let success = report.ending.success;
                        passed = state.progress.note(curriculum, report.stage, report.steps, success);
                    }
                    (state.progress.stage, state.progress.success_rate())
                };
                report.expected_return = self.expected(&report);
                self.log.episode(self.steps, stage, rate, &report)?;
                if let Some(Passed { stage, threshold, steps, rate }) = passed {
                    let pass = StagePassed { stage, threshold, step: self.steps, hours: self.hours() };
                    self.log.passed(&pass)?;
                    let how = if threshold { "is passed" } else { "is left, its steps are spent" };
                    let task = &self.config.curriculum.stages[stage];
                    let news = format!(
                        "step {}: stage {} ({task}) {how}, after {steps} steps with {:.0} % of its last episodes",
                        self.steps,
                        stage + 1,
                        100.0 * rate
                    );
                    self.show(shared, Some(news), progress);
                }
            }
        }
        Ok(())
    }
}

fn gone() -> TrainError {
    TrainError::Broken("all collectors ended; see the messages above".to_string())
}
