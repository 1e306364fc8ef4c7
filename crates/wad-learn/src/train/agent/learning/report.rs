//! A training's reports: metrics, progress, the summary at the end.

use super::{Learning, Progress, TrainError, Trained, lock};
use crate::train::agent::collector::Shared;
use std::collections::BTreeMap;
use std::time::Instant;
use tch::Device;
use wad_sim::telemetry::write_json;

impl Learning<'_> {
    pub(super) fn figures(&mut self) -> Result<(), TrainError> {
        let seconds = self.figures_at.elapsed().as_secs_f64();
        self.figures_at = Instant::now();
        let means = self.metrics.take();
        if let Some((name, _)) = means.iter().find(|(_, value)| !value.is_finite()) {
            return Err(self.diverged(name));
        }
        let updates = self.learner.updates();
        let mut values: Vec<(&str, f64)> = means.into_iter().collect();
        values.push(("charts/SPS", (self.steps - self.rate.last.0) as f64 / seconds));
        values.push(("charts/UPS", (updates - self.rate.last.1) as f64 / seconds));
        values.push(("charts/updates", updates as f64));
        values.push(("charts/buffer", self.buffer.len() as f64));
        values.push(("charts/demonstrated", self.demonstrations() as f64));
        values.push(("charts/hours", self.hours()));
        self.rate.last = (self.steps, updates);
        self.log.figures(self.steps, &values)
    }

    pub(super) fn show(
        &self,
        shared: &Shared,
        news: Option<String>,
        progress: &mut impl FnMut(Progress<'_>),
    ) {
        let (stage, success_rate) = {
            let schedule = lock(&shared.schedule);
            (schedule.state.progress.stage, schedule.state.progress.success_rate())
        };
        let stages = &self.config.curriculum.stages;
        progress(Progress {
            steps: self.steps,
            demonstrated: self.demonstrations(),
            updates: self.learner.updates(),
            task: stages.get(stage).map_or("", |stage| stage.task.name()),
            stage,
            stages: stages.len(),
            success_rate,
            mean_return: self.returns.iter().sum::<f64>() / self.returns.len().max(1) as f64,
            validating: self.validation.is_some(),
            news,
        });
    }

    /// Writes the last checkpoint, unless nothing was driven or learning diverged; without an error also the summary.
    pub(super) fn finish(
        mut self,
        shared: &Shared,
        result: Result<(), TrainError>,
    ) -> Result<Trained, TrainError> {
        // Launched work must be over before time is taken.
        if let Device::Cuda(index) = self.limits.device {
            tch::Cuda::synchronize(index as i64);
        }
        let measured = self.rate.began.map_or(0.0, |at| at.elapsed().as_secs_f64() - self.rate.paused);
        let (updates, steps) = (self.learner.updates(), self.steps);
        // The figures since the last line: a short training has no others.
        let unsaid = self.rate.began.is_some() && updates > self.rate.last.1;
        let result = if unsaid { result.and_then(|()| self.figures()) } else { result };
        let diverged = matches!(result, Err(TrainError::Diverged { .. }));
        let saved = if diverged || self.steps + self.demonstrations() == 0 {
            self.log.flush()
        } else {
            self.save(shared)
        };
        result.and(saved)?;
        let schedule = lock(&shared.schedule).state.clone();
        let per_step = |seconds: f64| 1000.0 * seconds / self.rate.env.steps.max(1) as f64;
        let env = &self.rate.env;
        let stages = BTreeMap::from([
            ("sumo", per_step(env.sumo)),
            ("physics", per_step(env.physics)),
            ("camera", per_step(env.camera)),
            ("perception", per_step(env.perception)),
            ("encoder", per_step(env.encoder)),
            ("reset", per_step(env.reset)),
            ("actor", per_step(self.rate.actor)),
            ("waiting", per_step(self.rate.waiting)),
            ("update", 1000.0 * self.rate.learning / (updates - self.rate.updates).max(1) as f64),
        ]);
        let per_second = |n: u64| if measured > 0.0 { n as f64 / measured } else { 0.0 };
        let wall_seconds = self.began.elapsed().as_secs_f64();
        let trained = Trained {
            algorithm: self.config.algorithm.agent_name().to_string(),
            seed: self.config.seed,
            steps,
            demonstrated: self.demonstrations(),
            updates,
            episodes: schedule.episodes,
            stage: schedule.progress.stage,
            stage_task: self
                .config
                .curriculum
                .stages
                .get(schedule.progress.stage)
                .map_or(String::new(), |stage| stage.task.name().to_string()),
            curriculum_done: schedule.progress.done,
            best: self.best,
            wall_seconds,
            total_seconds: self.before_seconds + wall_seconds,
            env_steps_per_s: per_second(steps - self.rate.steps.min(steps)),
            updates_per_s: per_second(updates - self.rate.updates.min(updates)),
            stages,
            interrupted: self.interrupted,
            out: self.limits.out.clone(),
        };
        write_json(&self.limits.out.join("summary.json"), &trained)?;
        Ok(trained)
    }
}
