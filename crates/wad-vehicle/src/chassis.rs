//! The ego's body in a rapier world: rays and springs by rapier's vehicle controller, tyres by
//! [`super::tyres`], collisions by rapier, and bounds on what a collision may do.
//!
//! rapier computes in single precision, so its origin travels with the ego.

use super::actuators::Demand;
use super::contacts::{Blow, ContactLog, Footprint};
use super::statics::Statics;
use super::surroundings::{EGO, GROUND, KERB, OBSTACLE, Owner, Reach, Surroundings, WHEEL_RAY, groups};
use super::tyres::Tyre;
use super::{EgoParams, GRAVITY, MovingBody, PartnerKind};
use rapier3d::control::{DynamicRayCastVehicleController, WheelTuning};
use rapier3d::prelude::*;
use sumo_network::geometry::{self, Point, direction};

/// The ego further than this from the world's origin moves the origin (m): single precision is then
/// still better than 0.02 mm.
const ORIGIN_RADIUS: f64 = 200.0;
/// Most that roll and pitch may turn (rad/s), freely and while something is touched.
const TILT_RATE: f32 = 2.5;
const TILT_RATE_TOUCHING: f32 = 1.0;
/// Fastest climb (m/s), freely and while something is touched.
const CLIMB: f32 = 3.0;
const CLIMB_TOUCHING: f32 = 0.5;
/// Fastest turn (rad/s) that a collision may give.
const YAW_RATE_TOUCHING: f32 = 3.0;
/// A body slower than this (m/s) counts as standing: touching it never adds energy.
const STANDING: f32 = 0.05;

/// Room (m) round a body that nothing can touch, beside the way that it goes.
const ROOM: f32 = 0.05;

/// Largest squeeze between two bodies that reports count, as a multiple of the ego's weight.
const SQUEEZE: f64 = 2.0;

/// One pair of touching colliders in one sub-step.
struct Touch {
    owner: Owner,
    /// Sum of the solver's normal impulses (N s), and where they push the ego.
    impulse: f32,
    direction: Vector,
    /// Where on the ego (m).
    point: geometry::Vector,
    /// m/s.
    partner_speed: f32,
}

/// The ego's body, wheels and surroundings.
pub(super) struct Chassis {
    world: PhysicsWorld,
    surroundings: Surroundings,
    body: RigidBodyHandle,
    collider: ColliderHandle,
    vehicle: DynamicRayCastVehicleController,
    /// The physics world's origin (m).
    origin: Point,
    /// Height of the road under the ego (m), where it is known.
    elevation: Option<f64>,
    /// A moving body may touch the ego in this tick.
    pressed: bool,
}

/// The body's motion in double precision, world frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub(super) pose: geometry::Pose,
    pub(super) roll: f64,
    pub(super) pitch: f64,
    /// Of the footprint's centre (m/s).
    pub(super) velocity: geometry::Vector,
    pub(super) yaw_rate: f64,
    /// Vertical part of the body's up axis: 1 upright, -1 on its roof.
    pub(super) upright: f64,
    /// Height of the body above its place at rest (m).
    pub(super) lift: f64,
}

impl Motion {
    pub(super) fn is_finite(&self) -> bool {
        let p = self.pose;
        [p.position.x, p.position.y, p.heading, self.velocity.x, self.velocity.y, self.yaw_rate, self.lift]
            .iter()
            .all(|n| n.is_finite())
    }
}

impl Chassis {
    /// An ego standing at rest on its springs at `pose`, moving forward at `speed` (m/s).
    pub(super) fn new(params: &EgoParams, pose: geometry::Pose, speed: f64) -> Self {
        let mut world = PhysicsWorld::new();
        world.gravity = Vector::new(0.0, 0.0, -GRAVITY as f32);
        // Few bodies touch the ego at a time; exact contacts matter more than their speed.
        world.integration_parameters.contact_recycling = false;
        world.integration_parameters.contact_clustering = false;
        Surroundings::lay_ground(&mut world);

        let inertia = params.inertia();
        let mass_properties = MassProperties::new(
            Vector::new(params.mass_offset() as f32, 0.0, params.mass_height as f32),
            params.mass as f32,
            Vector::new(inertia[0] as f32, inertia[1] as f32, inertia[2] as f32),
        );
        let velocity = direction(pose.heading) * speed;
        let rigid = RigidBodyBuilder::dynamic()
            .rotation(Vector::new(0.0, 0.0, pose.heading as f32))
            .linvel(Vector::new(velocity.x as f32, velocity.y as f32, 0.0))
            .additional_mass_properties(mass_properties)
            .can_sleep(false)
            .ccd_enabled(true);
        let half_height = 0.5 * (params.height - params.ground_clearance);
        let collider = ColliderBuilder::cuboid(
            0.5 * params.length as f32,
            0.5 * params.width as f32,
            half_height as f32,
        )
        .translation(Vector::new(0.0, 0.0, (params.ground_clearance + half_height) as f32))
        .density(0.0)
        .friction(params.body_friction as f32)
        .restitution(0.0)
        .collision_groups(groups(EGO, GROUND | OBSTACLE));
        let (body, collider) = world.insert(rigid, collider);
        // The rays' tree is built before the first step, so that the wheels stand from the start.
        world.detect_collisions(&(), &());
        Self {
            vehicle: wheels(params, body),
            world,
            surroundings: Surroundings::default(),
            body,
            collider,
            origin: pose.xy(),
            elevation: None,
            pressed: false,
        }
    }

    /// The body's motion.
    pub(super) fn motion(&self) -> Motion {
        let body = &self.world.bodies[self.body];
        let at = body.translation();
        let (forward, left, up) = axes(body);
        let heading = f64::from(forward.y).atan2(f64::from(forward.x));
        let v = body.linvel();
        let yaw_rate = f64::from(body.angvel().z);
        let arm = at - body.center_of_mass();
        let velocity = geometry::Vector::new(
            f64::from(v.x) - yaw_rate * f64::from(arm.y),
            f64::from(v.y) + yaw_rate * f64::from(arm.x),
        );
        Motion {
            pose: geometry::Pose::new(
                self.origin.x + f64::from(at.x),
                self.origin.y + f64::from(at.y),
                0.0,
                heading,
            ),
            roll: f64::from(left.z).atan2(f64::from(up.z)),
            pitch: -f64::from(forward.z).clamp(-1.0, 1.0).asin(),
            velocity,
            yaw_rate,
            upright: f64::from(up.z),
            lift: f64::from(at.z),
        }
    }

    /// Makes the physics world forget its fixed bodies.
    pub(super) fn clear_statics(&mut self) {
        self.surroundings.clear_statics(&mut self.world);
    }

    /// Brings in what is near, at a tick's begin.
    pub(super) fn place(&mut self, params: &EgoParams, bodies: &[MovingBody], reach: Reach) {
        self.elevation = reach.elevation;
        let shift = reach.ego - self.origin;
        if shift.norm() > ORIGIN_RADIUS {
            self.surroundings.clear_statics(&mut self.world);
            self.origin += shift;
            if let Some(body) = self.world.bodies.get_mut(self.body) {
                let at = body.translation();
                body.set_translation(at - Vector::new(shift.x as f32, shift.y as f32, 0.0), true);
            }
        }
        self.surroundings.place_movers(
            &mut self.world,
            bodies,
            self.origin,
            reach,
            self.collider,
            params.body_friction as f32,
        );
        let pose = self.motion().pose;
        self.pressed = self.surroundings.press(&pose, [params.length, params.width], reach);
    }

    /// One sub-step of `dt` (s), `elapsed` (s) after the tick's begin.
    pub(super) fn sub_step(
        &mut self,
        params: &EgoParams,
        statics: &Statics,
        demand: &Demand,
        (elapsed, dt): (f64, f64),
        log: &mut ContactLog,
    ) {
        let ego = self.motion().pose.xy();
        let friction = params.body_friction as f32;
        let changed = self.surroundings.refresh_statics(
            &mut self.world,
            statics,
            self.origin,
            ego,
            self.elevation,
            friction,
        );
        if changed {
            self.world.detect_collisions(&(), &());
        }
        self.surroundings.drive_movers(&mut self.world, elapsed, dt);
        self.springs(demand, dt as f32);
        self.tyres(params, demand, dt);

        let (speed, spin) = self.planar();
        self.world.integration_parameters.dt = dt as f32;
        if self.is_free(dt as f32) {
            self.fly(dt as f32);
            self.bound(params, speed, spin, None);
            return;
        }
        self.world.step();
        let touches = self.touches();
        if touches.is_empty() {
            self.bound(params, speed, spin, None);
            return;
        }
        self.report(params, statics, &touches, speed, log);
        self.release(params, &touches);
        let fastest = touches.iter().map(|touch| touch.partner_speed).fold(0.0, f32::max);
        self.bound(params, speed, spin, Some(fastest));
    }

    /// Whether nothing can touch the body within `dt` (s).
    fn is_free(&self, dt: f32) -> bool {
        let body = &self.world.bodies[self.body];
        let Some(collider) = self.world.colliders.get(self.collider) else { return false };
        let Some(in_body) = collider.position_wrt_parent() else { return false };
        // The collider's own position is that of the last step of the physics world.
        let bounds = collider.shape().compute_aabb(&(*body.position() * *in_body));
        if bounds.mins.z < ROOM || self.pressed {
            return false;
        }
        let queries = self.world.broad_phase.as_query_pipeline(
            self.world.narrow_phase.query_dispatcher(),
            &self.world.bodies,
            &self.world.colliders,
            QueryFilter::new().groups(groups(EGO, OBSTACLE)),
        );
        let reach = bounds.loosened(body.linvel().length() * dt + ROOM);
        queries.intersect_aabb_conservative(reach).next().is_none()
    }

    /// A step of `dt` (s) of a free body, as the physics world makes it, without its search for contacts and its
    /// solver: half the cost of a tick.
    fn fly(&mut self, dt: f32) {
        let parts = self.world.integration_parameters.num_solver_iterations;
        let part = dt / parts as f32;
        let fall = self.world.gravity * part;
        let Some(body) = self.world.bodies.get_mut(self.body) else { return };
        for _ in 0..parts {
            body.set_linvel(body.linvel() + fall, false);
            body.set_angvel(body.angvel_with_gyroscopic_forces(part), false);
            body.set_position(body.predict_position_using_velocity(part), false);
        }
    }

    /// Rays and springs. The springs' force is upright to the surface, so on a kerb's flank it also
    /// pushes along; that may slow the body (climbing costs energy) but never drives or turns it.
    fn springs(&mut self, demand: &Demand, dt: f32) {
        for (wheel, angle) in self.vehicle.wheels_mut().iter_mut().zip(demand.wheel_angles) {
            wheel.steering = angle as f32;
        }
        let (before, spin) = self.planar();
        let filter = QueryFilter::new().groups(groups(WHEEL_RAY, GROUND | KERB));
        let queries = self.world.broad_phase.as_query_pipeline_mut(
            self.world.narrow_phase.query_dispatcher(),
            &mut self.world.bodies,
            &mut self.world.colliders,
            filter,
        );
        self.vehicle.update_vehicle(dt, queries);
        if let Some(body) = self.world.bodies.get_mut(self.body) {
            let way = before.normalize_or_zero();
            let driven = (flat(body.linvel()) - before).dot(way);
            if driven > 0.0 {
                body.set_linvel(body.linvel() - way * driven, true);
            }
            let turn = body.angvel();
            if (turn.z - spin) * spin > 0.0 {
                body.set_angvel(Vector::new(turn.x, turn.y, spin), true);
            }
        }
    }

    /// Tyre forces and air drag.
    fn tyres(&mut self, params: &EgoParams, demand: &Demand, dt: f64) {
        let body = &self.world.bodies[self.body];
        let (forward, _, up) = axes(body);
        let wheels = self.vehicle.wheels();
        let load = |i: usize| {
            let wheel = &wheels[i];
            let force = wheel.wheel_suspension_force.min(wheel.max_suspension_force);
            if wheel.raycast_info().is_in_contact { f64::from(force) } else { 0.0 }
        };
        let loads: [f64; 4] = std::array::from_fn(load);
        let total: f64 = loads.iter().sum();
        let front: f64 = loads[0] + loads[1];
        let inertia = params.inertia();
        let pitching = params.mass_height.powi(2) / inertia[1];
        let rolling = params.mass_height.powi(2) / inertia[0];
        let mass_along = 0.25 / (1.0 / params.mass + pitching);
        let mass_across = 0.25 / (1.0 / params.mass + rolling);

        let mut impulses = [(Vector::ZERO, Vector::ZERO); 4];
        for (i, wheel) in wheels.iter().enumerate().take(4) {
            if loads[i] <= 0.0 {
                continue;
            }
            let contact = wheel.raycast_info();
            let normal = contact.contact_normal_ws;
            let heading = Rotation::from_axis_angle(up, wheel.steering) * forward;
            let left = normal.cross(heading).normalize_or_zero();
            let ahead = left.cross(normal);
            let velocity = body.velocity_at_point(contact.contact_point_ws);
            let is_front = i < 2;
            let stiffness =
                if is_front { params.cornering_stiffness_front } else { params.cornering_stiffness_rear };
            let share = loads[i] / total;
            let tyre = Tyre {
                load: loads[i],
                rolling: f64::from(velocity.dot(ahead)),
                sliding: f64::from(velocity.dot(left)),
                drive_force: if is_front { demand.drive_force * loads[i] / front } else { 0.0 },
                resistance: (demand.brake_force + demand.resistance) * share,
                cornering_stiffness: stiffness * loads[i],
                mass_along,
                mass_across,
                grip: params.tyre_grip,
                cornering_grip: if is_front { params.front_cornering_grip } else { 1.0 },
            };
            let [along, across] = tyre.force(dt);
            let impulse = ahead * (along * dt) as f32 + left * (across * dt) as f32;
            impulses[i] = (impulse, contact.contact_point_ws);
        }
        if let Some(body) = self.world.bodies.get_mut(self.body) {
            let v = flat(body.linvel());
            body.apply_impulse(-v * v.length() * (params.air_drag * dt) as f32, true);
            for (impulse, point) in impulses {
                body.apply_impulse_at_point(impulse, point, true);
            }
        }
    }

    /// Horizontal velocity (m/s) and yaw rate (rad/s).
    fn planar(&self) -> (Vector, f32) {
        let body = &self.world.bodies[self.body];
        (flat(body.linvel()), body.angvel().z)
    }

    /// What the body touched in the last step.
    fn touches(&self) -> Vec<Touch> {
        let mut touches = Vec::new();
        for pair in self.world.contact_pairs_with(self.collider) {
            if !pair.has_any_active_contact() {
                continue;
            }
            let first = pair.collider1 == self.collider;
            let other = if first { pair.collider2 } else { pair.collider1 };
            let Some(collider) = self.world.colliders.get(other) else { continue };
            let partner_speed = collider
                .parent()
                .and_then(|parent| self.world.bodies.get(parent))
                .map_or(0.0, |parent| parent.linvel().length());
            let (mut impulse, mut moment, mut push) = (0.0, Vector::ZERO, Vector::ZERO);
            for manifold in pair.manifolds() {
                for contact in &manifold.points {
                    impulse += contact.data.impulse;
                    moment += contact.data.impulse * if first { contact.local_p1 } else { contact.local_p2 };
                    push += contact.data.impulse * manifold.data.normal * if first { -1.0 } else { 1.0 };
                }
            }
            if impulse > 0.0 {
                // The collider's x and y are the ego's own.
                let at = moment / impulse;
                touches.push(Touch {
                    owner: Owner::decode(collider.user_data),
                    impulse,
                    direction: push.normalize_or_zero(),
                    point: geometry::Vector::new(f64::from(at.x), f64::from(at.y)),
                    partner_speed,
                });
            }
        }
        touches
    }

    /// Logs the touches of the last step, before which the horizontal velocity was `before` (m/s).
    fn report(
        &self,
        params: &EgoParams,
        statics: &Statics,
        touches: &[Touch],
        before: Vector,
        log: &mut ContactLog,
    ) {
        let dt = f64::from(self.world.integration_parameters.dt);
        // The solver's impulses also hold what pushes an overlap apart. What a contact gave is no
        // more than the body's momentum changed by, and a fair squeeze.
        let change = f64::from((self.planar().0 - before).length());
        let most = params.mass * (change + SQUEEZE * GRAVITY * dt);
        for touch in touches {
            let (kind, key) = match touch.owner {
                Owner::Ground => continue,
                Owner::Static(index) => (PartnerKind::Static, statics.bodies[index].key),
                Owner::Moving(kind, key) => (kind, key),
            };
            log.add(kind, key, f64::from(touch.impulse).min(most), touch.point);
        }
    }

    /// A moving body does not stop. If it presses the ego against something, the two pass through each
    /// other until they are apart again.
    fn release(&mut self, params: &EgoParams, touches: &[Touch]) {
        let hard = 0.5 * params.mass as f32;
        for touch in touches {
            let Owner::Moving(kind, key) = touch.owner else { continue };
            let pressed = touch.partner_speed > STANDING
                && touch.impulse > hard
                && touches
                    .iter()
                    .any(|other| other.impulse > hard && other.direction.dot(touch.direction) < -0.5);
            if pressed {
                self.surroundings.let_through(&mut self.world, kind, key);
            }
        }
    }

    /// Keeps a collision within what a car does: no energy from standing bodies, no faster than what
    /// pushes it, no flying, no spinning. `speed` and `spin` are the ego's before the step, `touched` is the
    /// speed of the fastest body touched (m/s).
    fn bound(&mut self, params: &EgoParams, speed: Vector, spin: f32, touched: Option<f32>) {
        let yaw_inertia = params.inertia()[2] as f32;
        let mass = params.mass as f32;
        let Some(body) = self.world.bodies.get_mut(self.body) else { return };
        let (mut v, mut turn) = (body.linvel(), body.angvel());
        let (tilt_rate, climb) = match touched {
            Some(_) => (TILT_RATE_TOUCHING, CLIMB_TOUCHING),
            None => (TILT_RATE, CLIMB),
        };
        match touched {
            Some(pusher) if pusher < STANDING => {
                let energy =
                    |v: Vector, spin: f32| mass * flat(v).length_squared() + yaw_inertia * spin * spin;
                let (before, after) = (energy(speed, spin), energy(v, turn.z));
                if after > before {
                    let scale = (before / after).sqrt();
                    v = Vector::new(v.x * scale, v.y * scale, v.z);
                    turn.z *= scale;
                }
            }
            Some(pusher) => {
                let most = speed.length().max(pusher);
                let now = flat(v).length();
                if now > most {
                    v = Vector::new(v.x * most / now, v.y * most / now, v.z);
                }
            }
            None => {}
        }
        if touched.is_some() {
            let most = spin.abs().max(YAW_RATE_TOUCHING);
            turn.z = turn.z.clamp(-most, most);
        }
        v.z = v.z.min(climb);
        turn.x = turn.x.clamp(-tilt_rate, tilt_rate);
        turn.y = turn.y.clamp(-tilt_rate, tilt_rate);
        if v != body.linvel() {
            body.set_linvel(v, true);
        }
        if turn != body.angvel() {
            body.set_angvel(turn, true);
        }
    }

    /// The ego's footprint and its velocity in its own frame.
    pub(super) fn footprint(&self) -> Footprint {
        let motion = self.motion();
        let ahead = direction(motion.pose.heading);
        Footprint {
            pose: motion.pose,
            velocity: geometry::Vector::new(motion.velocity.dot(&ahead), ahead.perp(&motion.velocity)),
            yaw_rate: motion.yaw_rate,
        }
    }

    /// Applies a horizontal blow at the height of the centre of mass.
    pub(super) fn strike(&mut self, blow: &Blow) {
        let pose = self.motion().pose;
        let ahead = direction(pose.heading);
        let left = geometry::Vector::new(-ahead.y, ahead.x);
        let impulse = ahead * blow.impulse.x + left * blow.impulse.y;
        let at = pose.to_world(blow.point) - self.origin;
        if let Some(body) = self.world.bodies.get_mut(self.body) {
            let height = body.center_of_mass().z;
            body.apply_impulse_at_point(
                Vector::new(impulse.x as f32, impulse.y as f32, 0.0),
                Vector::new(at.x as f32, at.y as f32, height),
                true,
            );
        }
    }

    /// Puts the body back on its wheels at `pose`, at rest.
    pub(super) fn set_upright(&mut self, pose: geometry::Pose) {
        let at = pose.xy() - self.origin;
        if let Some(body) = self.world.bodies.get_mut(self.body) {
            let translation = Vector::new(at.x as f32, at.y as f32, 0.0);
            let rotation = Rotation::from_rotation_z(pose.heading as f32);
            body.set_position(Pose::from_parts(translation, rotation), true);
            body.set_linvel(Vector::ZERO, true);
            body.set_angvel(Vector::ZERO, true);
        }
    }
}

#[cfg(test)]
impl Chassis {
    pub(super) fn simulated_colliders(&self) -> usize {
        self.world.colliders.len()
    }

    pub(super) fn overturn(&mut self) {
        let body = &mut self.world.bodies[self.body];
        let turned = *body.rotation() * Rotation::from_rotation_x(std::f32::consts::PI);
        body.set_position(Pose::from_parts(Vector::new(0.0, 0.0, 1.5), turned), true);
    }
}

/// The body's forward, left and up axes.
fn axes(body: &RigidBody) -> (Vector, Vector, Vector) {
    let rotation = body.rotation();
    (*rotation * Vector::X, *rotation * Vector::Y, *rotation * Vector::Z)
}

/// The horizontal part.
fn flat(v: Vector) -> Vector {
    Vector::new(v.x, v.y, 0.0)
}

/// Front left, front right, rear left, rear right.
fn wheels(params: &EgoParams, body: RigidBodyHandle) -> DynamicRayCastVehicleController {
    let mut vehicle = DynamicRayCastVehicleController::new(body);
    vehicle.index_up_axis = 2;
    vehicle.index_forward_axis = 0;
    let natural = std::f64::consts::TAU * params.suspension_frequency;
    let mount = params.wheel_radius + params.suspension_length - params.suspension_sag();
    for (x, share) in [(0.5, params.front_weight_share), (-0.5, 1.0 - params.front_weight_share)] {
        // Per unit of body mass, half an axle's share: the car sags evenly and stands level.
        let stiffness = 0.5 * share * natural * natural;
        let damping = 0.5 * share * 2.0 * params.suspension_damping * natural;
        for y in [0.5, -0.5] {
            let tuning = WheelTuning {
                suspension_stiffness: stiffness as f32,
                suspension_compression: damping as f32,
                suspension_damping: damping as f32,
                max_suspension_travel: params.suspension_length as f32,
                // rapier's own tyre is off: see `super::tyres`.
                side_friction_stiffness: 0.0,
                friction_slip: params.tyre_grip as f32,
                max_suspension_force: (1.5 * params.mass * GRAVITY) as f32,
            };
            let at = Vector::new((x * params.wheelbase) as f32, (y * params.track) as f32, mount as f32);
            vehicle.add_wheel(
                at,
                Vector::NEG_Z,
                Vector::NEG_Y,
                params.suspension_length as f32,
                params.wheel_radius as f32,
                &tuning,
            );
        }
    }
    vehicle
}
