//! Drives one segment and records its frames.

use super::collect::CollectOptions;
use super::error::DatasetError;
use super::eye::{Eye, Moment};
use super::noise::Disturber;
use super::plan::Segment;
use super::record::Frame;
use crate::autopilot::{Autopilot, EgoModel};
use crate::bridge::{Bridge, BridgeOptions, Ego, Lamps};
use crate::destination::Destinations;
use crate::drive::{first_route, polygons};
use crate::network::{LanePosition, Network};
use crate::traffic::TrafficSpec;
use crate::vehicle::{self, Control};
use crate::{seeds, sight};
use std::path::Path;
use std::sync::Arc;

/// Driven before the first frame (s).
const WARM_UP: f64 = 8.0;
/// A standing ego's view is kept this seldom (s).
const STANDING_EVERY: f64 = 2.5;
/// Standing for so long it is put down elsewhere (s): enough for a red light.
const STUCK_AFTER: f64 = 75.0;
/// Frames go on for this long after a crash (s).
const AFTER_CRASH: f64 = 1.0;
/// An impulse that is a crash (N s), and how far off the route it is put back (m).
const CRASH: f64 = 200.0;
const LOST: f64 = 8.0;
/// A crash-free drive from one place lasts at most this long (s); then another place is seen.
const LONGEST_STAY: f64 = 240.0;

/// How long after a frame the next one is due, where the ego has stood for `standing` (all s).
pub(super) fn due(standing: f64, every: f64) -> f64 {
    if standing > 1.0 { STANDING_EVERY } else { every }
}

/// One segment under way.
pub struct SegmentDrive<'a> {
    options: &'a CollectOptions,
    bridge: Bridge,
    network: Arc<Network>,
    ego: Ego,
    autopilot: Autopilot,
    noise: Disturber,
    destinations: Destinations,
    eye: Eye,
    /// Time since the last frame, since the ego last moved, since a crash, at this place (s).
    since_frame: f64,
    standing: f64,
    crashed: Option<f64>,
    stay: f64,
    control: Control,
}

impl<'a> SegmentDrive<'a> {
    /// Starts SUMO and puts the ego somewhere.
    ///
    /// # Errors
    /// Bad input, or SUMO fails.
    pub async fn start(
        options: &'a CollectOptions,
        config: &Path,
        segment: Segment,
        scratch: &Path,
    ) -> Result<Self, DatasetError> {
        let mut bridge = Bridge::start(&BridgeOptions {
            seed: segment.seed,
            traffic: TrafficSpec::Counts(segment.traffic),
            ..BridgeOptions::new(config, scratch)
        })
        .await?;
        let network = bridge.network().clone();
        let mut destinations = Destinations::new(&network, seeds::rng(segment.seed, "route"))?;
        let route = first_route(&network, &mut destinations)?;
        let params = vehicle::EgoParams::default();
        let mut ego = Ego::new("ego", params.clone(), route, 0.0);
        let statics = vehicle::statics_from_network(&network, &polygons(&bridge, &network));
        ego.vehicle_mut().set_statics(statics);
        bridge.spawn(&mut ego).await?;
        // One town for all segments: the buildings' faces do not change with the traffic.
        let town = sight::town(&bridge, options.seed);
        Ok(Self {
            options,
            eye: Eye::new(town, segment, options.camera)?,
            bridge,
            network,
            autopilot: Autopilot::new(Default::default(), EgoModel::from(&params)),
            ego,
            noise: Disturber::new(options.noise, seeds::rng(segment.seed, "noise")),
            destinations,
            since_frame: 0.0,
            standing: 0.0,
            crashed: None,
            stay: 0.0,
            control: Control::default(),
        })
    }

    /// Drives until the next frame is due, and looks.
    ///
    /// # Errors
    /// SUMO fails, or the picture cannot be encoded.
    pub async fn next_frame(&mut self) -> Result<Frame, DatasetError> {
        loop {
            self.tick().await?;
            let elapsed = self.bridge.tick();
            self.since_frame += elapsed;
            let due = due(self.standing, self.options.every);
            if self.bridge.time() >= WARM_UP && self.since_frame >= due - 1e-6 {
                break;
            }
        }
        let frame = self.eye.record(
            &self.network,
            &self.ego,
            Moment {
                time: self.bridge.time(),
                since: self.since_frame,
                control: self.control,
                disturbed: self.noise.is_disturbed() || self.crashed.is_some(),
            },
        )?;
        self.since_frame = 0.0;
        Ok(frame)
    }

    async fn tick(&mut self) -> Result<(), DatasetError> {
        let tick = self.bridge.tick();
        let before = self.ego.on_route();
        let decision = self.autopilot.control(
            &self.network,
            self.ego.route(),
            before.s,
            &before.state,
            self.ego.world(),
            tick,
        );
        self.ego.set_lamps(Lamps {
            blinker_left: decision.blinker_left,
            blinker_right: decision.blinker_right,
            brake: decision.brake_light,
        });
        let params = self.ego.params();
        let curvature = params.max_steer_angle.tan() / params.wheelbase;
        self.control = self.noise.disturb(decision.control, before.state.speed, curvature, tick);
        let contacts = self.ego.advance(self.control, tick);
        self.bridge.step(&mut [&mut self.ego]).await?;
        self.eye.follow(&self.ego);
        self.stay += tick;
        self.standing = if self.ego.state().speed.abs() < 0.3 { self.standing + tick } else { 0.0 };
        if let Some(since) = &mut self.crashed {
            *since += tick;
        } else if contacts.iter().any(|contact| contact.impulse > CRASH) {
            self.crashed = Some(0.0);
        }
        self.go_on().await
    }

    /// A new destination on arrival; another place after a crash, when stuck, lost or too long about.
    async fn go_on(&mut self) -> Result<(), DatasetError> {
        let at = self.ego.on_route();
        let over = self.crashed.is_some_and(|since| since > AFTER_CRASH)
            || self.standing > STUCK_AFTER
            || at.d.abs() > LOST
            || self.stay > LONGEST_STAY;
        if !over {
            if self.ego.route().length() - at.s > 5.0 {
                return Ok(());
            }
            // The new route begins a car's length behind the ego, on the lane that it is on.
            let lane = self.ego.lane();
            let here = self.network.lane(lane).shape.project(self.ego.state().pose.xy()).s;
            let from = LanePosition { lane, s: (here - self.ego.params().length).max(0.0) };
            if let Ok(route) = self.destinations.route_from(&self.network, from)
                && route.length() >= 60.0
            {
                self.ego.set_route(route, here - from.s);
                return Ok(());
            }
        }
        let mut route = first_route(&self.network, &mut self.destinations)?;
        for _ in 0..20 {
            if self.bridge.is_free(&[route.at(0.0).lane]).await? {
                break;
            }
            route = first_route(&self.network, &mut self.destinations)?;
        }
        self.ego.respawn(route, 0.0);
        let model = EgoModel::from(self.ego.params());
        self.autopilot = Autopilot::new(Default::default(), model);
        self.eye.reset();
        (self.crashed, self.stay, self.standing) = (None, 0.0, 0.0);
        Ok(())
    }

    /// Ends SUMO.
    pub async fn finish(self) {
        if let Err(error) = self.bridge.close().await {
            tracing::warn!("SUMO did not close properly: {error}");
        }
    }
}
