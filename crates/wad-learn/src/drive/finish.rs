//! The end of a run: its summary, and SUMO's.

use super::summary::{EgoSummary, Summary, Totals};
use super::{Car, Drive, DriveError};
use wad_sim::bridge::Ego;
use wad_sim::end::End;

impl Drive {
    /// The summary so far. A run that is not over has survived until now.
    pub fn summary(&self, interrupted: bool) -> Summary {
        self.summary_of(End::Survived, interrupted)
    }

    /// `end` is that of a run without a scenario that ended one.
    fn summary_of(&self, end: End, interrupted: bool) -> Summary {
        let mut sum = Totals::default();
        for car in &self.cars {
            sum.add_all(&car.totals);
        }
        let (t, ticks) = (&sum, self.ticks());
        // Of all egos.
        let per_tick = |sum: f64| if t.ticks == 0 { 0.0 } else { sum / t.ticks as f64 };
        let tick = self.session.bridge().tick();
        let wall_seconds = self.began.elapsed().as_secs_f64();
        Summary {
            town: self.session.bridge().config().name(),
            seed: self.options.bridge.seed,
            ticks,
            tick_ms: tick * 1000.0,
            sim_seconds: ticks as f64 * tick,
            wall_seconds,
            ticks_per_second: ticks as f64 / wall_seconds.max(1e-9),
            distance_m: t.distance,
            mean_speed_mps: per_tick(t.distance / tick),
            mean_free_speed_mps: if t.free.0 == 0 { 0.0 } else { t.free.1 / t.free.0 as f64 },
            held_ticks: t.ticks - t.free.0,
            top_speed_mps: t.top_speed,
            destinations_reached: t.destinations,
            collisions: t.collisions,
            collisions_caused: t.caused,
            red_lights_run: t.red_lights,
            outside_lane_ticks: t.outside_ticks,
            sidewalk_events: t.sidewalk,
            vehicle_blocked: t.blocked,
            respawns: t.respawns,
            vehicles_mean: per_tick(t.vehicles as f64),
            pedestrians_mean: per_tick(t.pedestrians as f64),
            end: self.ending.as_ref().map_or(end, |ending| ending.end),
            success: self.ending.as_ref().map(|ending| ending.success),
            cause: self.ending.as_ref().map(|ending| ending.cause.clone()),
            interrupted,
            collisions_among_egos: t.among_egos,
            egos: self.ego_summaries(),
            out: self.folder.path().to_path_buf(),
        }
    }

    /// Where there are several: each ego's own.
    fn ego_summaries(&self) -> Vec<EgoSummary> {
        let of = |(car, ego): (&Car, &Ego)| car.totals.of_ego(&ego.id, self.session.bridge().tick());
        let all = || self.cars.iter().zip(self.egos()).map(of).collect();
        if self.cars.len() > 1 { all() } else { Vec::new() }
    }

    /// After an error: writes a summary with the end `error`, and ends SUMO.
    ///
    /// # Errors
    /// The summary cannot be written.
    pub async fn abort(mut self) -> Result<(), DriveError> {
        let summary = self.summary_of(End::Error, false);
        Ok(self.folder.finish(&summary)?)
    }

    /// Ends SUMO and writes the summary.
    ///
    /// # Errors
    /// The summary cannot be written.
    pub async fn finish(mut self, interrupted: bool) -> Result<Summary, DriveError> {
        let summary = self.summary(interrupted);
        self.folder.finish(&summary)?;
        if let Err(error) = self.session.close().await {
            tracing::warn!("SUMO did not close properly: {error}");
        }
        Ok(summary)
    }
}
