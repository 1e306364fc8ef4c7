//! The ego vehicle: drives tick by tick.

use super::actuators::Actuators;
use super::chassis::{Chassis, Motion};
use super::contacts::{ContactLog, PedestrianStrikes};
use super::statics::Statics;
use super::surroundings::Reach;
use super::{Contact, Control, EgoParams, EgoState, MovingBody, PartnerKind, StaticBody};
use sumo_network::geometry::{Pose, direction};

/// Sub-steps per second.
const SUB_STEPS: f64 = 60.0;
/// Longer than this on its side or roof (s), and the ego is put back on its wheels.
const OVERTURNED_FOR: f64 = 1.0;

/// The ego vehicle with its own physics world.
///
/// The ground is flat; slopes are the caller's. Equal parameters, poses, statics and
/// inputs give equal states bit for bit, on a new ego and after [`EgoVehicle::respawn`] alike.
///
/// ```
/// use sumo_network::geometry::Pose;
/// use wad_vehicle::{Control, EgoParams, EgoVehicle};
///
/// let mut ego = EgoVehicle::new(EgoParams::default(), Pose::new(0.0, 0.0, 0.0, 0.0), 0.0);
/// for _ in 0..12 {
///     ego.tick(Control { throttle: 1.0, ..Control::default() }, 0.167, &[]);
/// }
/// assert!(ego.state().speed > 5.0);
/// ```
pub struct EgoVehicle {
    params: EgoParams,
    statics: Statics,
    chassis: Chassis,
    actuators: Actuators,
    strikes: PedestrianStrikes,
    state: EgoState,
    /// Height of the road under the ego (m), where it is known.
    elevation: Option<f64>,
    /// How long the ego has lain on its side or roof (s).
    overturned: f64,
}

impl EgoVehicle {
    /// An ego with its footprint's centre at `pose`, moving forward at `speed` (m/s).
    pub fn new(params: EgoParams, pose: Pose, speed: f64) -> Self {
        let (pose, speed) = (finite_pose(pose), finite(speed));
        let chassis = Chassis::new(&params, pose, speed);
        let state = state_of(&chassis.motion(), 0.0);
        Self {
            params,
            statics: Statics::default(),
            chassis,
            actuators: Actuators::default(),
            strikes: PedestrianStrikes::default(),
            state,
            elevation: None,
            overturned: 0.0,
        }
    }

    /// Starts again at `pose` and `speed` (m/s) as a new ego with the same parameters and statics.
    pub fn respawn(&mut self, pose: Pose, speed: f64) {
        let statics = std::mem::take(&mut self.statics);
        *self = Self { statics, ..Self::new(self.params.clone(), pose, speed) };
    }

    /// The vehicle's parameters.
    pub fn params(&self) -> &EgoParams {
        &self.params
    }

    /// Its motion now. The pose's height is that of [`EgoVehicle::set_elevation`], or 0.
    pub fn state(&self) -> EgoState {
        let mut state = self.state;
        state.pose.position.z = self.elevation.unwrap_or(0.0);
        state
    }

    /// Sets the height of the road under the ego (m), which the physics does not know. Bodies and statics
    /// on another level, more than 3 m above or below, are then ignored. None, as at the
    /// start and after a respawn, takes everything to be on one level.
    pub fn set_elevation(&mut self, elevation: Option<f64>) {
        self.elevation = elevation.filter(|z| z.is_finite());
    }

    /// Replaces the fixed bodies. Thousands cost nothing per tick: only the near ones are simulated.
    pub fn set_statics(&mut self, bodies: Vec<StaticBody>) {
        self.statics = Statics::new(bodies);
        self.chassis.clear_statics();
    }

    /// The fixed bodies, as they were set.
    pub fn statics(&self) -> &[StaticBody] {
        &self.statics.bodies
    }

    /// Drives for `duration_s` (s) among `bodies`, which are where they say at the tick's begin and
    /// keep their velocity. Returns the contacts of the tick, by kind and key, without the wheels' contacts
    /// with kerbs.
    ///
    /// Control out of range is clamped, and what is not a number counts as 0. A duration that is not
    /// positive does nothing.
    pub fn tick(&mut self, control: Control, duration_s: f64, bodies: &[MovingBody]) -> Vec<Contact> {
        if !(duration_s.is_finite() && duration_s > 0.0) {
            return Vec::new();
        }
        let control = control.clamped();
        let sub_steps = (duration_s * SUB_STEPS).round().max(1.0) as usize;
        let dt = duration_s / sub_steps as f64;
        let last_good = self.state.pose;
        let before = self.state.speed;

        let reach = Reach {
            ego: self.state.pose.xy(),
            velocity: self.state.velocity,
            radius: 0.5 * self.params.length.hypot(self.params.width),
            duration: duration_s,
            elevation: self.elevation,
        };
        let (pedestrians, movers): (Vec<_>, Vec<_>) = bodies
            .iter()
            .copied()
            .filter(|body| reach.covers(body))
            .partition(|body| body.kind == PartnerKind::Pedestrian);
        self.chassis.place(&self.params, &movers, reach);
        let mut log = ContactLog::default();
        let mut speed = before;
        for i in 0..sub_steps {
            let demand = self.actuators.advance(&self.params, &control, speed, dt);
            let span = (i as f64 * dt, dt);
            self.chassis.sub_step(&self.params, &self.statics, &demand, span, &mut log);
            let elapsed = (i + 1) as f64 * dt;
            let footprint = self.chassis.footprint();
            speed = footprint.velocity.x;
            let blows = self.strikes.check(&self.params, &footprint, &pedestrians, elapsed, &mut log);
            for blow in blows {
                self.chassis.strike(&blow);
            }
        }
        self.recover(last_good, duration_s);
        let motion = self.chassis.motion();
        self.state = state_of(&motion, self.actuators.steer_angle);
        self.state.acceleration = (self.state.speed - before) / duration_s;
        log.finish()
    }

    /// Puts an ego that overturned, fell out of the world or lost its numbers back on its wheels.
    fn recover(&mut self, last_good: Pose, duration: f64) {
        let motion = self.chassis.motion();
        if !motion.is_finite() {
            // The physics world is replaced: any number in it may be NaN.
            self.chassis = Chassis::new(&self.params, last_good, 0.0);
            self.overturned = 0.0;
            return;
        }
        self.overturned = if motion.upright < 0.5 { self.overturned + duration } else { 0.0 };
        if self.overturned > OVERTURNED_FOR || motion.lift.abs() > 2.0 {
            self.chassis.set_upright(motion.pose);
            self.overturned = 0.0;
        }
    }
}

#[cfg(test)]
impl EgoVehicle {
    /// Colliders in the physics world.
    pub(super) fn simulated_colliders(&self) -> usize {
        self.chassis.simulated_colliders()
    }

    /// Turns it on its roof.
    pub(super) fn overturn(&mut self) {
        self.chassis.overturn();
    }
}

fn state_of(motion: &Motion, steer_angle: f64) -> EgoState {
    let ahead = direction(motion.pose.heading);
    EgoState {
        pose: motion.pose,
        roll: motion.roll,
        pitch: motion.pitch,
        velocity: motion.velocity,
        speed: motion.velocity.dot(&ahead),
        lateral_speed: ahead.perp(&motion.velocity),
        yaw_rate: motion.yaw_rate,
        acceleration: 0.0,
        steer_angle,
    }
}

fn finite(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

fn finite_pose(pose: Pose) -> Pose {
    let p = pose.position;
    Pose::new(finite(p.x), finite(p.y), finite(p.z), finite(pose.heading))
}

impl Control {
    /// The control within its ranges; what is not a number becomes 0.
    pub fn clamped(self) -> Self {
        let within = |value: f64, low: f64| if value.is_nan() { 0.0 } else { value.clamp(low, 1.0) };
        Self {
            throttle: within(self.throttle, 0.0),
            steer: within(self.steer, -1.0),
            brake: within(self.brake, 0.0),
            reverse: self.reverse,
        }
    }
}
