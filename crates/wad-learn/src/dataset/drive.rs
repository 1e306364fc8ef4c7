//! Drives one segment and records its frames.

use super::error::DatasetError;
use super::eye::{Eye, Moment};
use super::noise::Disturber;
use super::options::CollectOptions;
use super::plan::{Segment, due};
use super::record::Frame;
use std::path::Path;
use std::sync::Arc;
use sumo_network::seeds;
use wad_sim::assets::Assets;
use wad_sim::bridge::BridgeOptions;
use wad_sim::session::{Act, Itinerary, Seat, Session};
use wad_sim::traffic::TrafficSpec;
use wad_vehicle::{Control, EgoParams};

/// Time before the first frame (s).
const WARM_UP: f64 = 8.0;
/// Standing time after which the ego is moved to another place (s): longer than a red light.
const STUCK_AFTER: f64 = 75.0;
/// Frames go on for this long after a crash (s).
const AFTER_CRASH: f64 = 1.0;
/// Impulse from which a collision is a crash (N s), and distance from the route at which the ego is moved
/// back (m).
const CRASH: f64 = 200.0;
const LOST: f64 = 8.0;
/// Distance to the route's end that counts as arrival (m).
const ARRIVED: f64 = 5.0;
/// A crash-free drive from one place lasts at most this long (s); then another place is seen.
const LONGEST_STAY: f64 = 240.0;

/// The session's only ego, and what SUMO calls it.
const EGO: usize = 0;
const EGO_ID: &str = "ego";

/// A running segment.
pub struct SegmentDrive<'a> {
    options: &'a CollectOptions,
    session: Session,
    noise: Disturber,
    itinerary: Itinerary,
    eye: Eye,
    /// Time since the last frame, since the ego last moved, since a crash, at this place (s).
    since_frame: f64,
    standing: f64,
    crashed: Option<f64>,
    stay: f64,
    control: Control,
}

impl<'a> SegmentDrive<'a> {
    /// Starts SUMO and places the ego at random.
    ///
    /// # Errors
    /// Bad input, or SUMO fails.
    pub async fn start(
        options: &'a CollectOptions,
        assets: &Arc<Assets>,
        segment: Segment,
        scratch: &Path,
    ) -> Result<Self, DatasetError> {
        let mut itinerary = Itinerary::new(assets.network(), seeds::rng(segment.seed, "route"))?;
        let route = itinerary.first_route(assets.network())?;
        let ego = EgoParams::default();
        let seat = Seat::new(assets, EGO_ID, ego, Default::default(), Default::default(), route);
        let bridge = BridgeOptions {
            seed: segment.seed,
            traffic: TrafficSpec::Counts(segment.traffic),
            ..BridgeOptions::new(assets.config(), scratch)
        };
        Ok(Self {
            options,
            eye: Eye::new(assets, segment, options)?,
            session: Session::start(assets, &bridge, vec![seat]).await?,
            noise: Disturber::new(options.noise, seeds::rng(segment.seed, "noise")),
            itinerary,
            since_frame: 0.0,
            standing: 0.0,
            crashed: None,
            stay: 0.0,
            control: Control::default(),
        })
    }

    /// Drives until the next frame is due, and makes it.
    ///
    /// # Errors
    /// SUMO fails, or the picture cannot be encoded.
    pub async fn next_frame(&mut self) -> Result<Frame, DatasetError> {
        loop {
            // The world around a new place is known after the next tick.
            let moved = self.tick().await?;
            self.since_frame = if moved { 0.0 } else { self.since_frame + self.session.bridge().tick() };
            let due = due(self.standing, self.options.every);
            if self.session.bridge().time() >= WARM_UP && self.since_frame >= due - 1e-6 {
                break;
            }
        }
        let frame = self.eye.record(
            self.session.network(),
            self.session.ego(EGO),
            Moment {
                time: self.session.bridge().time(),
                since: self.since_frame,
                control: self.control,
                disturbed: self.noise.is_disturbed() || self.crashed.is_some(),
            },
        )?;
        self.since_frame = 0.0;
        Ok(frame)
    }

    /// True: the ego is at another place now.
    async fn tick(&mut self) -> Result<bool, DatasetError> {
        let tick = self.session.bridge().tick();
        let wanted = self.session.plan(EGO).control;
        let ego = self.session.ego(EGO);
        let params = ego.params();
        let curvature = params.max_steer_angle.tan() / params.wheelbase;
        self.control = self.noise.disturb(wanted, ego.state().speed, curvature, tick);
        let done = self.session.step_one(Act::Disturbed(self.control)).await?;
        self.eye.follow(self.session.ego(EGO));
        self.stay += tick;
        self.standing = if done.after.state.speed.abs() < 0.3 { self.standing + tick } else { 0.0 };
        if let Some(since) = &mut self.crashed {
            *since += tick;
        } else if done.contacts.iter().any(|contact| contact.impulse > CRASH) {
            self.crashed = Some(0.0);
        }
        self.go_on().await
    }

    /// A new destination on arrival; another place (then it is true) after a crash, when stuck, lost or too long about.
    async fn go_on(&mut self) -> Result<bool, DatasetError> {
        let ego = self.session.ego(EGO);
        let at = ego.on_route();
        let over = self.crashed.is_some_and(|since| since > AFTER_CRASH)
            || self.standing > STUCK_AFTER
            || at.d.abs() > LOST
            || self.stay > LONGEST_STAY;
        let arrived = ego.route().length() - at.s <= ARRIVED;
        if !over && (!arrived || self.itinerary.go_on(&mut self.session, EGO)) {
            return Ok(false);
        }
        self.itinerary.start_elsewhere(&mut self.session, EGO).await?;
        self.eye.reset();
        (self.crashed, self.stay, self.standing) = (None, 0.0, 0.0);
        Ok(true)
    }

    /// Ends SUMO.
    pub async fn finish(self) {
        if let Err(error) = self.session.close().await {
            tracing::warn!("SUMO did not close properly: {error}");
        }
    }
}
