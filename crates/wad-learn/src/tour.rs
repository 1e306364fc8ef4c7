//! A drive through a town that takes differing pictures, for scoring and for training.

use crate::drive::{Drive, DriveError, DriveOptions};
use sumo_network::geometry::Pose;
use sumo_network::world::WorldState;
use wad_camera::Town;
use wad_camera::scene::Look;
use wad_see::perception::EgoFacts;

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
        let town = drive.assets().town_with(Look::of(scene_seed));
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

    /// What the ego knows at the last view, `since` s after the view before.
    pub fn facts(&self, since: f64) -> EgoFacts<'_> {
        EgoFacts::of(self.drive.bridge().network(), self.drive.ego(), since)
    }

    /// What is near the ego at the last view.
    pub fn world(&self) -> &WorldState {
        self.drive.ego().world()
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
