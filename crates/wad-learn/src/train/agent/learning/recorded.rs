//! Loads recorded episodes into the replay buffer.

use super::{Learning, Maker, Progress, TrainError};
use crate::train::agent::other_days::OtherDays;
use crate::train::agent::recording;
use std::sync::atomic::{AtomicBool, Ordering};
use sumo_network::seeds;

impl Learning<'_> {
    /// Fills the buffer with recorded episodes, with latents of this training's encoder.
    pub(super) fn recall(
        &mut self,
        interrupt: &AtomicBool,
        maker: &Maker,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        if self.config.recorded.is_empty() {
            return Ok(());
        }
        let rng = seeds::rng(self.config.seed, "other days of what was recorded");
        let mut encoder = OtherDays::before((maker.encoder)()?, self.config.other_days, rng);
        let camera = self.config.env.camera.hash();
        for folder in &self.config.recorded {
            let before = self.demonstrated;
            let files = recording::list(folder)?;
            for file in &files {
                if interrupt.load(Ordering::Relaxed) {
                    return Ok(());
                }
                let (_, segments) = recording::load(file, &camera, &mut *encoder, self.config.dims())?;
                for segment in &segments {
                    self.buffer.push(segment);
                    self.demonstrated += segment.len() as u64;
                }
            }
            let news = format!(
                "{} recorded steps in {} episodes of `{}`",
                self.demonstrated - before,
                files.len(),
                folder.display()
            );
            progress(Progress {
                steps: self.steps,
                demonstrated: self.demonstrated,
                updates: 0,
                task: "",
                stage: 0,
                stages: self.config.curriculum.stages.len(),
                success_rate: 0.0,
                mean_return: 0.0,
                validating: false,
                news: Some(news),
            });
        }
        Ok(())
    }
}
