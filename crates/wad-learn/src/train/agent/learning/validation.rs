//! Validation: the episodes that choose the best actor.

use super::{Best, Learning, Progress, TrainError};
use crate::train::agent::collector::{Shared, lock};
use crate::train::agent::schedule::{ActorCopy, Report, Schedule};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::Arc;

/// An actor that drives less than this in all episodes stands still (m).
const STANDS: f64 = 5.0;

/// A running validation.
pub(super) struct Validation {
    pub(super) steps: u64,
    pub(super) actor: Arc<ActorCopy>,
    pub(super) expected: usize,
    pub(super) reports: Vec<Report>,
}

impl Learning<'_> {
    pub(super) fn start_validation(&mut self, shared: &Shared) {
        // Validates exactly the parameters that a file would hold.
        self.version += 1;
        let policy = self.policy(serde_json::Value::Null, &self.learner.kept_actor_values(), self.steps);
        let actor = Arc::new(ActorCopy { version: self.version, values: policy.values, scale: policy.scale });
        let expected = lock(&shared.schedule).validate(self.config, &actor);
        self.validation = Some(Validation { steps: self.steps, actor, expected, reports: Vec::new() });
    }

    pub(super) fn finish_validation(
        &mut self,
        shared: &Shared,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        let Some(validation) = self.validation.take() else { return Ok(()) };
        self.validated_at = validation.steps;
        let reports = &validation.reports;
        let successes = reports.iter().filter(|r| r.ending.success).count();
        let full = Schedule::full_validation(self.config).max(1);
        let mean =
            |f: &dyn Fn(&Report) -> f64| reports.iter().map(f).sum::<f64>() / reports.len().max(1) as f64;
        let now = Best {
            steps: validation.steps,
            success_rate: successes as f64 / full as f64,
            mean_return: mean(&|r| r.episodic_return),
        };
        let mut by_task: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
        for report in reports {
            let of = by_task.entry(report.task.kind.name()).or_default();
            of.0 += usize::from(report.ending.success);
            of.1 += 1;
        }
        let text: Vec<String> = by_task.iter().map(|(task, (s, n))| format!("{task} {s}/{n}")).collect();
        let speed = mean(&|r| r.mean_speed);
        self.log.figures(
            validation.steps,
            &[
                ("validation/success_rate", now.success_rate),
                ("validation/episodic_return", now.mean_return),
                ("validation/mean_speed", speed),
            ],
        )?;
        let better = self
            .best
            .is_none_or(|best| (now.success_rate, now.mean_return) > (best.success_rate, best.mean_return));
        if better {
            self.best = Some(now);
            let scores = json!({
                "validation": now,
                "tasks": by_task.iter().map(|(t, (s, n))| (*t, json!({ "successes": s, "episodes": n })))
                    .collect::<BTreeMap<_, _>>(),
                "mean_speed": speed,
            });
            let policy = self.policy(scores, &validation.actor.values, validation.steps);
            policy.save(&self.limits.out.join("best.safetensors"))?;
        }
        let news = format!(
            "step {}: validation {}; {:.1} m/s{}",
            validation.steps,
            text.join(", "),
            speed,
            if better { "; best so far" } else { "" }
        );
        self.show(shared, Some(news), progress);
        if reports.iter().all(|report| report.distance < STANDS) {
            let news = format!(
                "step {}: the actor stands still: it drove less than {STANDS} m in each of the {} validation episodes; \
                 more steps seldom help, try another seed, a smaller learning rate or another reward",
                validation.steps,
                reports.len()
            );
            self.show(shared, Some(news), progress);
        }
        Ok(())
    }
}
