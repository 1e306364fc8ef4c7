//! Validation: the episodes that choose the best actor.

use super::{Best, Learning, Policy, Progress, TrainError};
use crate::train::agent::collector::{Shared, lock};
use crate::train::agent::schedule::{ActorCopy, Report, Schedule};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::Arc;

/// An actor that drives less than this in all episodes stands still (m).
const STANDS: f64 = 5.0;

/// A running validation.
pub(super) struct Validation {
    /// What a file of the actor would hold.
    pub(super) policy: Policy,
    pub(super) actor: Arc<ActorCopy>,
    pub(super) expected: usize,
    pub(super) reports: Vec<Report>,
}

impl Learning<'_> {
    pub(super) fn start_validation(&mut self, shared: &Shared) {
        self.version += 1;
        let policy = self.policy();
        let (values, scale) = (policy.values.clone(), policy.scale.clone());
        let actor = Arc::new(ActorCopy { version: self.version, values, scale });
        let expected = lock(&shared.schedule).validate(self.config, &actor);
        self.validation = Some(Validation { policy, actor, expected, reports: Vec::new() });
    }

    pub(super) fn finish_validation(
        &mut self,
        shared: &Shared,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        let Some(Validation { mut policy, reports, .. }) = self.validation.take() else { return Ok(()) };
        let steps = policy.card.steps;
        self.validated_at = steps;
        // Whole validations alone: one that is cut off is driven again.
        for report in &reports {
            self.log.validation_episode(steps, report)?;
        }
        let successes = reports.iter().filter(|r| r.ending.success).count();
        let full = Schedule::full_validation(self.config).max(1);
        let mean =
            |f: &dyn Fn(&Report) -> f64| reports.iter().map(f).sum::<f64>() / reports.len().max(1) as f64;
        let now = Best {
            steps,
            success_rate: successes as f64 / full as f64,
            mean_return: mean(&|r| r.episodic_return),
        };
        let mut by_task: BTreeMap<String, (usize, usize)> = BTreeMap::new();
        for report in &reports {
            let stage = &self.config.curriculum.stages[report.stage];
            let of = by_task.entry(stage.to_string()).or_default();
            of.0 += usize::from(report.ending.success);
            of.1 += 1;
        }
        let text: Vec<String> = by_task.iter().map(|(task, (s, n))| format!("{task} {s}/{n}")).collect();
        let speed = mean(&|r| r.mean_speed);
        self.log.figures(
            steps,
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
            policy.card.scores = json!({
                "validation": now,
                "tasks": by_task.iter().map(|(t, (s, n))| (t, json!({ "successes": s, "episodes": n })))
                    .collect::<BTreeMap<_, _>>(),
                "mean_speed": speed,
            });
            policy.save(&self.limits.out.join("best.safetensors"))?;
        }
        let news = format!(
            "step {steps}: validation {}; {speed:.1} m/s{}",
            text.join(", "),
            if better { "; best so far" } else { "" }
        );
        self.show(shared, Some(news), progress);
        if reports.iter().all(|report| report.distance < STANDS) {
            let news = format!(
                "step {steps}: the actor stands still: it drove less than {STANDS} m in each of the {} validation \
                 episodes; more steps seldom help, try another seed, a smaller learning rate or another reward",
                reports.len()
            );
            self.show(shared, Some(news), progress);
        }
        Ok(())
    }
}
