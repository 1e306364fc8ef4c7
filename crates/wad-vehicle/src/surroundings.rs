//! The ground, the fixed bodies near the ego and the moving ones in its reach, as colliders of
//! the physics world.

use super::statics::{OBSTACLE_SPAN, StaticKind, Statics, same_level};
use super::{GRAVITY, MovingBody, PartnerKind};
use rapier3d::prelude::*;
use std::collections::BTreeMap;
use sumo_network::geometry::{self, Point, direction};

/// Fixed bodies within this distance (m) are in the physics world ...
const STATIC_RADIUS: f64 = 40.0;
/// ... and searched again once the ego has moved or climbed this far (m).
const STATIC_STEP: f64 = 15.0;
const CLIMB_STEP: f64 = 1.0;
/// A moving body is in the physics world when it can come this close (m) within the tick: as much as
/// the ego may be thrown off its way by a collision.
const REACH_MARGIN: f64 = 2.0;
/// A moving body that stays further away than this (m), and than the ego may swerve, does not touch the ego within the tick: by
/// the way of both if they keep their motion.
const TOUCH_MARGIN: f64 = 0.5;

/// Collision groups.
pub(super) const GROUND: Group = Group::GROUP_1;
pub(super) const KERB: Group = Group::GROUP_2;
pub(super) const OBSTACLE: Group = Group::GROUP_3;
pub(super) const EGO: Group = Group::GROUP_4;
pub(super) const WHEEL_RAY: Group = Group::GROUP_5;

/// The owner of a collider, kept in its user data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Owner {
    Ground,
    /// Index of a fixed body.
    Static(usize),
    /// Kind and key of a moving body.
    Moving(PartnerKind, u64),
}

impl Owner {
    fn encode(self) -> u128 {
        match self {
            Self::Ground => 0,
            Self::Static(index) => (1 << 64) | index as u128,
            Self::Moving(kind, key) => ((2 + kind as u128) << 64) | u128::from(key),
        }
    }

    pub(super) fn decode(data: u128) -> Self {
        match (data >> 64, data as u64) {
            (0, _) => Self::Ground,
            (1, index) => Self::Static(index as usize),
            (2, key) => Self::Moving(PartnerKind::Vehicle, key),
            (3, key) => Self::Moving(PartnerKind::Pedestrian, key),
            (_, key) => Self::Moving(PartnerKind::Static, key),
        }
    }
}

pub(super) fn groups(member: Group, with: Group) -> InteractionGroups {
    InteractionGroups::new(member, with, InteractionTestMode::And)
}

/// A moving body in the physics world.
struct Mover {
    body: RigidBodyHandle,
    size: [f64; 3],
    /// How it moves in this tick.
    motion: MovingBody,
    /// Still near in the present tick.
    present: bool,
    /// Let through the ego until they are apart.
    ghost: bool,
}

/// Which moving bodies the ego can meet within a tick.
#[derive(Clone, Copy)]
pub(super) struct Reach {
    /// The ego's centre (m), velocity (m/s) and bounding radius (m).
    pub(super) ego: Point,
    pub(super) velocity: sumo_network::geometry::Vector,
    pub(super) radius: f64,
    /// The tick (s).
    pub(super) duration: f64,
    /// Height of the ego's road (m), where it is known.
    pub(super) elevation: Option<f64>,
}

impl Reach {
    /// How far (m) the ego's tyres may take it off the way of its velocity.
    fn swerve(&self) -> f64 {
        0.5 * GRAVITY * self.duration * self.duration
    }

    /// Whether a body is usable and can come within [`REACH_MARGIN`] of the ego.
    pub(super) fn covers(&self, body: &MovingBody) -> bool {
        let numbers = [body.pose.position.x, body.pose.position.y, body.pose.heading, body.speed];
        let sizes = [body.length, body.width, body.height];
        if numbers.iter().any(|n| !n.is_finite()) || sizes.iter().any(|&s| !(s > 0.0 && s < 100.0)) {
            return false;
        }
        if !same_level(Some(body.pose.position.z), self.elevation) {
            return false;
        }
        let apart = body.pose.xy() - self.ego;
        let closing = direction(body.pose.heading) * body.mean_speed(self.duration) - self.velocity;
        // When the two, each keeping its velocity, are closest.
        let when = -apart.dot(&closing) / closing.norm_squared().max(1e-9);
        let closest = apart + closing * when.clamp(0.0, self.duration);
        let own_radius = 0.5 * body.length.hypot(body.width);
        let reach = self.radius + own_radius + REACH_MARGIN + self.swerve();
        closest.norm_squared() <= reach * reach
    }
}

/// What surrounds the ego in the physics world.
#[derive(Default)]
pub(super) struct Surroundings {
    /// Piece index to collider.
    statics: BTreeMap<usize, ColliderHandle>,
    /// Where fixed bodies were last searched, and on which level (m).
    looked_at: Option<(Point, Option<f64>)>,
    movers: BTreeMap<(u8, u64), Mover>,
}

impl Surroundings {
    /// Lays the ground: a slab with its top at height 0.
    pub(super) fn lay_ground(world: &mut PhysicsWorld) {
        let slab = ColliderBuilder::cuboid(1000.0, 1000.0, 5.0)
            .translation(Vector::new(0.0, 0.0, -5.0))
            .friction(0.5)
            .collision_groups(groups(GROUND, EGO | WHEEL_RAY))
            .user_data(Owner::Ground.encode());
        world.colliders.insert(slab);
    }

    /// Forgets every fixed body: the set, or the world's origin, has changed.
    pub(super) fn clear_statics(&mut self, world: &mut PhysicsWorld) {
        for handle in std::mem::take(&mut self.statics).into_values() {
            world.remove_collider(handle);
        }
        self.looked_at = None;
    }

    /// Keeps the fixed bodies round `ego` (m) in the physics world, whose origin is at `origin`.
    /// True when any came in or went.
    pub(super) fn refresh_statics(
        &mut self,
        world: &mut PhysicsWorld,
        statics: &Statics,
        origin: Point,
        ego: Point,
        elevation: Option<f64>,
        friction: f32,
    ) -> bool {
        let still_good = |(at, height): (Point, Option<f64>)| {
            let climb = height.unwrap_or_default() - elevation.unwrap_or_default();
            (at - ego).norm_squared() < STATIC_STEP * STATIC_STEP
                && height.is_some() == elevation.is_some()
                && climb.abs() < CLIMB_STEP
        };
        if self.looked_at.is_some_and(still_good) {
            return false;
        }
        self.looked_at = Some((ego, elevation));
        let near = statics.near(ego, STATIC_RADIUS, elevation);
        let mut changed = false;
        self.statics.retain(|index, handle| {
            let keep = near.binary_search(index).is_ok();
            if !keep {
                changed = true;
                world.remove_collider(*handle);
            }
            keep
        });
        for index in near {
            if self.statics.contains_key(&index) {
                continue;
            }
            let piece = &statics.pieces[index];
            let at = piece.centre - origin;
            let translation = Vector::new(at.x as f32, at.y as f32, piece.height as f32);
            let kerb = statics.bodies[piece.body].kind == StaticKind::Kerb;
            let collider = ColliderBuilder::new(piece.shape.clone())
                .position(Pose::from_parts(translation, piece.rotation))
                .friction(friction)
                // Nothing collides with a kerb: only the wheels' rays see it.
                .collision_groups(if kerb { groups(KERB, WHEEL_RAY) } else { groups(OBSTACLE, EGO) })
                .user_data(Owner::Static(piece.body).encode());
            self.statics.insert(index, world.colliders.insert(collider));
            changed = true;
        }
        changed
    }

    /// Puts the moving bodies that the ego can meet where they are at the tick's begin, and takes the
    /// others out.
    pub(super) fn place_movers(
        &mut self,
        world: &mut PhysicsWorld,
        bodies: &[MovingBody],
        origin: Point,
        reach: Reach,
        ego: ColliderHandle,
        friction: f32,
    ) {
        for mover in self.movers.values_mut() {
            mover.present = false;
        }
        for body in bodies {
            if !reach.covers(body) {
                continue;
            }
            let size = [body.length, body.width, body.height];
            let id = (body.kind as u8, body.key);
            if let Some(mover) = self.movers.get(&id)
                && mover.size != size
            {
                world.remove_body(mover.body);
                self.movers.remove(&id);
            }
            let mover = self.movers.entry(id).or_insert_with(|| Mover {
                body: insert_mover(world, body, friction),
                size,
                motion: *body,
                present: false,
                ghost: false,
            });
            if mover.present {
                continue; // The same key twice in one tick: the first stands.
            }
            mover.present = true;
            mover.motion = *body;
            let at = body.pose.xy() - origin;
            if let Some(rigid) = world.bodies.get_mut(mover.body) {
                let translation = Vector::new(at.x as f32, at.y as f32, 0.0);
                let rotation = Rotation::from_rotation_z(body.pose.heading as f32);
                rigid.set_position(Pose::from_parts(translation, rotation), true);
                if mover.ghost {
                    let position = *rigid.position();
                    let collider = rigid.colliders().first().copied();
                    mover.ghost = !solid_again(world, ego, collider, &position);
                }
            }
        }
        self.movers.retain(|_, mover| {
            if !mover.present {
                world.remove_body(mover.body);
            }
            mover.present
        });
    }
}

impl Surroundings {
    /// Whether a moving body may touch the ego, a box of `size` (length and width, m) at `pose`, within a tick
    /// ([`TOUCH_MARGIN`]).
    pub(super) fn press(&self, pose: &geometry::Pose, size: [f64; 2], reach: Reach) -> bool {
        let margin = TOUCH_MARGIN.max(reach.swerve());
        self.movers.values().any(|mover| {
            let MovingBody { pose: from, length, width, .. } = mover.motion;
            let to = mover.motion.at(reach.duration).xy() - reach.velocity * reach.duration;
            let (from, to, turn) = (pose.to_local(from.xy()), pose.to_local(to), from.heading - pose.heading);
            let (sin, cos) = (turn.sin().abs(), turn.cos().abs());
            let meet = |from: f64, to: f64, own: f64, its: f64| {
                let apart = 0.5 * (own + its) + margin;
                from.min(to) < apart && from.max(to) > -apart
            };
            meet(from.x, to.x, size[0], length * cos + width * sin)
                && meet(from.y, to.y, size[1], length * sin + width * cos)
        })
    }

    /// Sends the moving bodies on their way from `elapsed` (s) after the tick's begin, for `dt` (s).
    pub(super) fn drive_movers(&self, world: &mut PhysicsWorld, elapsed: f64, dt: f64) {
        for mover in self.movers.values() {
            let (from, to) = (mover.motion.at(elapsed), mover.motion.at(elapsed + dt));
            let velocity = (to.xy() - from.xy()) / dt;
            let turn = (to.heading - from.heading) / dt;
            if let Some(rigid) = world.bodies.get_mut(mover.body) {
                rigid.set_linvel(Vector::new(velocity.x as f32, velocity.y as f32, 0.0), true);
                rigid.set_angvel(Vector::new(0.0, 0.0, turn as f32), true);
            }
        }
    }

    /// Lets a moving body through the ego until they are apart.
    pub(super) fn let_through(&mut self, world: &mut PhysicsWorld, kind: PartnerKind, key: u64) {
        let Some(mover) = self.movers.get_mut(&(kind as u8, key)) else { return };
        mover.ghost = true;
        let handle = world.bodies.get(mover.body).and_then(|rigid| rigid.colliders().first().copied());
        if let Some(collider) = handle.and_then(|handle| world.colliders.get_mut(handle)) {
            collider.set_collision_groups(groups(OBSTACLE, Group::NONE));
        }
    }
}

fn insert_mover(world: &mut PhysicsWorld, body: &MovingBody, friction: f32) -> RigidBodyHandle {
    let half = |size: f64| 0.5 * size as f32;
    let (low, high) = OBSTACLE_SPAN;
    let collider = ColliderBuilder::cuboid(half(body.length), half(body.width), half(high - low))
        .translation(Vector::new(0.0, 0.0, half(high + low)))
        .friction(friction)
        .collision_groups(groups(OBSTACLE, EGO))
        .user_data(Owner::Moving(body.kind, body.key).encode());
    let rigid = RigidBodyBuilder::kinematic_velocity_based().can_sleep(false);
    world.insert(rigid, collider).0
}

/// Lets a ghost collide again once it has left the ego. True when it has.
fn solid_again(
    world: &mut PhysicsWorld,
    ego: ColliderHandle,
    ghost: Option<ColliderHandle>,
    position: &Pose,
) -> bool {
    let (Some(ghost), Some(ego)) = (ghost, world.colliders.get(ego)) else { return true };
    let Some(shape) = world.colliders.get(ghost).map(|c| c.shared_shape().clone()) else { return true };
    let overlap = rapier3d::parry::query::intersection_test(ego.position(), ego.shape(), position, &*shape);
    if overlap.is_ok_and(|found| found.intersecting) {
        return false;
    }
    if let Some(collider) = world.colliders.get_mut(ghost) {
        collider.set_collision_groups(groups(OBSTACLE, EGO));
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn owners_survive_their_encoding() {
        for owner in [
            Owner::Ground,
            Owner::Static(0),
            Owner::Static(123_456),
            Owner::Moving(PartnerKind::Vehicle, u64::MAX),
            Owner::Moving(PartnerKind::Static, 0),
        ] {
            assert_eq!(Owner::decode(owner.encode()), owner);
        }
    }
}
