//! A drive through a town that takes differing pictures, for scoring and for training.

use crate::drive::{Drive, DriveError, DriveOptions};
use sumo_network::geometry::Pose;
use wad_camera::Town;

/// The autopilot drives, and stops at each new view.
pub struct Tour {
    drive: Drive,
    town: Town,
    last: Option<(f64, Pose)>,
}

/// Seconds before the first view, in which the traffic spreads out.
const WARM_UP: f64 = 20.0;
/// A view is new after this many metres, or after this many seconds at standstill.
const METRES: f64 = 8.0;
const SECONDS: f64 = 6.0;

impl Tour {
    /// Starts SUMO and builds the town with `scene_seed`.
    ///
    /// # Errors
    /// As [`Drive::start`].
    pub async fn start(options: DriveOptions, scene_seed: u64) -> Result<Self, DriveError> {
        let drive = Drive::start(options).await?;
        let town = drive.assets().town_with(scene_seed);
        let mut tour = Self { drive, town, last: None };
        let until = tour.drive.bridge().time() + WARM_UP;
        while tour.drive.bridge().time() < until {
            tour.tick().await?;
        }
        Ok(tour)
    }

    async fn tick(&mut self) -> Result<(), DriveError> {
        self.drive.tick().await?;
        self.town.follow(self.drive.ego().world(), None);
        Ok(())
    }

    /// Drives to the next view and returns the ego's pose there.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn next(&mut self) -> Result<Pose, DriveError> {
        loop {
            self.tick().await?;
            let (time, pose) = (self.drive.bridge().time(), self.drive.ego().state().pose);
            let is_new = self.last.is_none_or(|(then, there)| {
                (pose.position - there.position).norm() > METRES || time - then > SECONDS
            });
            if is_new {
                self.last = Some((time, pose));
                return Ok(pose);
            }
        }
    }

    /// The town, for a camera.
    pub fn town(&self) -> &Town {
        &self.town
    }

    /// Ends SUMO.
    ///
    /// # Errors
    /// The drive's summary cannot be written.
    pub async fn finish(self) -> Result<(), DriveError> {
        self.drive.finish(false).await.map(|_| ())
    }
}
