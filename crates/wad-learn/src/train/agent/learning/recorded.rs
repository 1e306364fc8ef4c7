//! Loads recorded episodes into the replay buffer.

use super::{Learning, Progress, TrainError};
use crate::train::agent::other_days::OtherDays;
use crate::train::agent::recording;
use std::sync::atomic::{AtomicBool, Ordering};
use sumo_network::seeds;
use wad_see::latent::Encoder;

impl Learning<'_> {
    /// Fills the buffer with recorded episodes, with latents of `encoder`. They count when all are there: a
    /// checkpoint with a part of them would go on with that part.
    pub(super) fn recall(
        &mut self,
        interrupt: &AtomicBool,
        encoder: Box<dyn Encoder>,
        progress: &mut impl FnMut(Progress<'_>),
    ) -> Result<(), TrainError> {
        let rng = seeds::rng(self.config.seed, "other days of what was recorded");
        let mut encoder = OtherDays::before(encoder, self.config.other_days, rng);
        let camera = self.config.env.camera.hash();
        let mut recalled = 0;
        for folder in &self.config.recorded {
            let before = recalled;
            let files = recording::list(folder)?;
            for file in &files {
                if interrupt.load(Ordering::Relaxed) {
                    return Ok(());
                }
                let (_, segments) = recording::load(file, &camera, &mut *encoder, self.config.dims())?;
                for segment in &segments {
                    self.buffer.push(segment);
                    recalled += segment.len() as u64;
                }
            }
            let news = format!(
                "{} recorded steps in {} episodes of `{}`",
                recalled - before,
                files.len(),
                folder.display()
            );
            progress(Progress {
                steps: self.steps,
                demonstrated: recalled,
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
        self.recorded = recalled;
        Ok(())
    }
}
