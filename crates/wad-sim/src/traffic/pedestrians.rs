//! The background pedestrians: where they start, how far they walk, and when they are replaced.

use super::Options;
use super::draw::between;
use super::events::StepEvents;
use super::fleet::draw_walker;
use super::places::{distance, point_on};
use super::slots::{Member, Slots};
use super::vehicles::Scene;
use super::walks::{Walk, Walks, sidewalk};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use sumo_network::geometry::{Point, Pose};
use sumo_network::network::{EdgeId, Network};
use sumo_traci::{Batch, Color, Position2D, RemoveReason, Replies, Ticket, person};

/// Random places tried for one pedestrian.
const DRAWS: usize = 64;
/// Walks in a row at the most.
const LEGS: usize = 8;
/// A walk is followed up when at most this share of it can be done, less a margin (s).
const FOLLOW_UP: f64 = 0.85;
const FOLLOW_UP_MARGIN: f64 = 10.0;
/// A pedestrian this much beyond the sight distance (m) may come into sight before the next tick.
const SIGHT_MARGIN: f64 = 5.0;

/// What is known of a pedestrian.
#[derive(Debug)]
struct Walker {
    /// Walking speed (m/s).
    speed: f64,
    /// Where its last walk ends: edge and SUMO lane_position (m).
    end: (EdgeId, f64),
}

/// Getters in flight about one pedestrian.
#[derive(Debug)]
struct Look {
    slot: usize,
    serial: u64,
    stages: Ticket<i32>,
    position: Ticket<Position2D>,
}

#[derive(Debug)]
pub(super) struct Pedestrians {
    network: Arc<Network>,
    options: Options,
    rng: ChaCha8Rng,
    walks: Walks,
    slots: Slots<Walker>,
    looks: Vec<Look>,
}

impl Pedestrians {
    pub fn new(network: Arc<Network>, options: Options, rng: ChaCha8Rng) -> Self {
        let walks = Walks::new(&network);
        Self { network, options, rng, walks, slots: Slots::default(), looks: Vec::new() }
    }

    /// Whether the net has sidewalks that lead anywhere.
    pub fn possible(&self) -> bool {
        !self.walks.is_empty()
    }

    /// How many were in the network after the last step.
    pub fn alive(&self) -> usize {
        self.slots.alive()
    }

    pub fn owns(&self, id: &str) -> bool {
        self.slots.find(id).is_some()
    }

    /// Puts `count` pedestrians on the sidewalks; returns how many found a place.
    pub fn populate(&mut self, count: usize, egos: &[Pose], batch: &mut Batch) -> usize {
        let avoid = self.options.avoid;
        for placed in 0..count {
            let Some((edge, at)) = self.draw_place(|point| avoid.allows_at_start(egos, point)) else {
                return placed;
            };
            let slot = self.slots.add();
            self.insert(slot, edge, at, 0.0, batch);
        }
        count
    }

    /// Keeps `count` pedestrians from now on: the last ones go, or new ones come with the next updates.
    pub fn resize(&mut self, count: usize, batch: &mut Batch) {
        self.slots.resize(count, |id| remove(id, batch));
    }

    /// Follows one step: see [`super::Population::update`].
    pub fn update(
        &mut self,
        events: &StepEvents<'_>,
        replies: &Replies,
        scene: Scene<'_>,
        batch: &mut Batch,
    ) {
        // SUMO lets persons depart at once; one that did not was refused and does not exist.
        self.slots.follow(&events.departed_persons, &events.arrived_persons, |_| {});
        self.read_looks(replies, scene, batch);
        for slot in std::mem::take(&mut self.slots.vacant) {
            if !self.replace(slot, scene, batch) {
                self.slots.vacant.push(slot);
            }
        }
        while let Some((slot, serial)) = self.slots.schedule.due(scene.time) {
            let Some(member) = self.slots.with_serial(slot, serial) else { continue };
            self.looks.push(Look {
                slot,
                serial,
                stages: batch.get(person::STAGES_REMAINING, &member.id),
                position: batch.get(person::POSITION, &member.id),
            });
        }
    }

    /// A random place on a sidewalk that `allowed` permits.
    fn draw_place(&mut self, allowed: impl Fn(Point) -> bool) -> Option<(EdgeId, f64)> {
        for _ in 0..DRAWS {
            let (edge, at) = self.walks.draw_start(&mut self.rng, &self.network)?;
            let lane = sidewalk(&self.network, edge)?;
            if allowed(point_on(&self.network, lane, at)) {
                return Some((edge, at));
            }
        }
        None
    }

    /// Fills a slot out of the ego's sight, or as far from it as a few dozen draws come.
    fn replace(&mut self, slot: usize, scene: Scene<'_>, batch: &mut Batch) -> bool {
        let avoid = self.options.avoid;
        let hidden = |p| !avoid.in_sight(scene.egos, p) && avoid.clear_of(scene.near, p);
        let mut place = self.draw_place(hidden);
        if place.is_none() && !scene.egos.is_empty() {
            let mut furthest = avoid.start;
            for _ in 0..DRAWS {
                let Some((edge, at)) = self.walks.draw_start(&mut self.rng, &self.network) else { break };
                let Some(lane) = sidewalk(&self.network, edge) else { continue };
                let distance = distance(scene.egos, point_on(&self.network, lane, at));
                if distance > furthest {
                    furthest = distance;
                    place = Some((edge, at));
                }
            }
        }
        let Some((edge, at)) = place else { return false };
        self.insert(slot, edge, at, scene.time, batch);
        true
    }

    /// Adds a pedestrian with a walk of its own.
    fn insert(&mut self, slot: usize, edge: EdgeId, at: f64, time: f64, batch: &mut Batch) {
        let (kind, [r, g, b]) = draw_walker(&mut self.rng);
        let speed = kind.speed.draw(&mut self.rng);
        let walks = self.draw_walks(edge, at);
        if walks.is_empty() {
            self.slots.vacant.push(slot);
            return;
        }
        self.slots.fill(slot, "wad_p", Walker { speed, end: (edge, at) });
        let Some(Member { id, .. }) = self.slots.get(slot) else { return };
        let edge_id = &self.network.edge(edge).id;
        let add = person::Add { edge: edge_id, position: at, person_type: kind.id, ..Default::default() };
        person::add(batch, id, &add);
        batch.set(person::SET_COLOR, id, Color::rgb(r, g, b));
        self.append(&walks, slot, time, batch);
    }

    /// Walks one after the other from a place on; empty if no walk starts there.
    fn draw_walks(&mut self, mut edge: EdgeId, mut at: f64) -> Vec<Walk> {
        let (shortest, longest) = self.options.walk_length;
        let mut wanted = between(&mut self.rng, shortest, longest);
        let mut walks = Vec::new();
        while wanted > 0.0 && walks.len() < LEGS {
            let Some(walk) = self.walks.walk(&mut self.rng, &self.network, edge, at, wanted) else { break };
            wanted -= walk.length;
            (edge, at) = end_of(&walk, edge);
            walks.push(walk);
        }
        walks
    }

    /// Appends walks to a pedestrian's plan, and schedules a check before they end.
    fn append(&mut self, walks: &[Walk], slot: usize, time: f64, batch: &mut Batch) {
        let Some(Member { id, serial, about, .. }) = self.slots.get_mut(slot) else { return };
        let mut edges: Vec<&str> = Vec::new();
        for walk in walks {
            edges.clear();
            edges.extend(walk.edges.iter().map(|&e| self.network.edge(e).id.as_str()));
            let stage = person::WalkingStage {
                edges: &edges,
                arrival_position: walk.to,
                speed: about.speed,
                ..Default::default()
            };
            person::append_walking_stage(batch, id, &stage);
            about.end = end_of(walk, about.end.0);
        }
        let length: f64 = walks.iter().map(|w| w.length).sum();
        let lasts = (FOLLOW_UP * length / about.speed - FOLLOW_UP_MARGIN).max(1.0);
        let serial = *serial;
        self.slots.schedule.at(time + lasts, slot, serial);
    }

    fn read_looks(&mut self, replies: &Replies, scene: Scene<'_>, batch: &mut Batch) {
        let avoid = self.options.avoid;
        for Look { slot, serial, stages, position } in std::mem::take(&mut self.looks) {
            let Some(member) = self.slots.with_serial(slot, serial) else { continue };
            let (Ok(stages), Ok(position)) = (replies.get(stages), replies.get(position)) else {
                self.slots.schedule.at(scene.time + 1.0, slot, serial);
                continue;
            };
            if stages > 1 {
                // It was held up: its last walk has not begun.
                self.slots.schedule.at(scene.time + 20.0, slot, serial);
                continue;
            }
            let here = Point::new(position.x, position.y);
            let seen = distance(scene.egos, here) < avoid.sight + SIGHT_MARGIN;
            if !seen {
                self.slots.evict(slot, |id| remove(id, batch));
                continue;
            }
            let (edge, at) = member.about.end;
            let walks = self.draw_walks(edge, at);
            self.append(&walks, slot, scene.time, batch);
        }
    }
}

fn remove(id: &str, batch: &mut Batch) {
    person::remove(batch, id, RemoveReason::Vaporized);
}

/// Where a walk from `first` ends.
fn end_of(walk: &Walk, first: EdgeId) -> (EdgeId, f64) {
    (walk.edges.last().copied().unwrap_or(first), walk.to)
}
