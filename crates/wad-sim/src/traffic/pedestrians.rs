//! The background pedestrians: where they start, how far they walk, and what becomes of them.

use super::Options;
use super::draw::between;
use super::events::StepEvents;
use super::fleet::draw_walker;
use super::places::point_on;
use super::schedule::Schedule;
use super::vehicles::Scene;
use super::walks::{Walk, Walks, sidewalk};
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;
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

/// A pedestrian that was given to SUMO.
#[derive(Debug)]
struct Member {
    id: String,
    serial: u64,
    /// Walking speed (m/s).
    speed: f64,
    /// Where its last walk ends: edge and SUMO lane_position (m).
    end: (EdgeId, f64),
    departed: bool,
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
    members: Vec<Option<Member>>,
    /// Slots by SUMO's id; looked up only, never walked through.
    slots: HashMap<String, usize>,
    pending: Vec<usize>,
    vacant: Vec<usize>,
    /// Slots that are to stay empty since the population was made smaller.
    retired: Vec<usize>,
    schedule: Schedule,
    looks: Vec<Look>,
    next_serial: u64,
    alive: usize,
}

impl Pedestrians {
    pub fn new(network: Arc<Network>, options: Options, rng: ChaCha8Rng) -> Self {
        let walks = Walks::new(&network);
        Self {
            network,
            options,
            rng,
            walks,
            members: Vec::new(),
            slots: HashMap::new(),
            pending: Vec::new(),
            vacant: Vec::new(),
            retired: Vec::new(),
            schedule: Schedule::default(),
            looks: Vec::new(),
            next_serial: 0,
            alive: 0,
        }
    }

    /// Whether the net has sidewalks that lead anywhere.
    pub fn possible(&self) -> bool {
        !self.walks.is_empty()
    }

    /// How many were in the network after the last step.
    pub fn alive(&self) -> usize {
        self.alive
    }

    pub fn owns(&self, id: &str) -> bool {
        self.slots.contains_key(id)
    }

    /// Puts `count` pedestrians on the sidewalks; returns how many found a place.
    pub fn populate(&mut self, count: usize, ego: Option<Pose>, batch: &mut Batch) -> usize {
        let avoid = self.options.avoid;
        for placed in 0..count {
            let Some((edge, at)) = self.draw_place(|point| avoid.allows_at_start(ego, point)) else {
                return placed;
            };
            let slot = self.members.len();
            self.members.push(None);
            self.insert(slot, edge, at, 0.0, batch);
        }
        count
    }

    /// Keeps `count` pedestrians from now on: the last ones go, or new ones come with the next updates.
    pub fn resize(&mut self, count: usize, batch: &mut Batch) {
        let kept = self.members.len() - self.retired.len();
        for _ in count..kept {
            let Some(slot) = (0..self.members.len()).rev().find(|slot| !self.retired.contains(slot)) else {
                break;
            };
            if let Some(member) = &self.members[slot] {
                person::remove(batch, &member.id, RemoveReason::Vaporized);
            }
            self.pending.retain(|&pending| pending != slot);
            self.vacate(slot);
            self.vacant.retain(|&vacant| vacant != slot);
            self.retired.push(slot);
        }
        for _ in kept..count {
            let slot = self.retired.pop().unwrap_or_else(|| {
                self.members.push(None);
                self.members.len() - 1
            });
            self.vacant.push(slot);
        }
    }

    /// Follows one step: see [`super::Population::update`].
    pub fn update(
        &mut self,
        events: &StepEvents<'_>,
        replies: &Replies,
        scene: Scene<'_>,
        batch: &mut Batch,
    ) {
        for id in &events.arrived_persons {
            if let Some(slot) = self.slots.get(*id).copied() {
                self.vacate(slot);
            }
        }
        self.note_departures(events);
        self.alive = self.members.iter().flatten().filter(|m| m.departed).count();
        self.read_looks(replies, scene, batch);
        for slot in std::mem::take(&mut self.vacant) {
            if !self.replace(slot, scene, batch) {
                self.vacant.push(slot);
            }
        }
        while let Some((slot, serial)) = self.schedule.due(scene.time) {
            let Some(member) = self.members[slot].as_ref().filter(|m| m.serial == serial) else { continue };
            self.looks.push(Look {
                slot,
                serial,
                stages: batch.get(person::STAGES_REMAINING, &member.id),
                position: batch.get(person::POSITION, &member.id),
            });
        }
    }

    fn note_departures(&mut self, events: &StepEvents<'_>) {
        if self.pending.is_empty() {
            return;
        }
        for id in &events.departed_persons {
            let member = self.slots.get(*id).and_then(|&slot| self.members[slot].as_mut());
            if let Some(member) = member {
                member.departed = true;
            }
        }
        for slot in std::mem::take(&mut self.pending) {
            // SUMO lets persons depart at once; one that did not was refused and does not exist.
            if self.members[slot].as_ref().is_some_and(|m| !m.departed) {
                self.vacate(slot);
            }
        }
    }

    fn vacate(&mut self, slot: usize) {
        if let Some(member) = self.members[slot].take() {
            self.slots.remove(&member.id);
            self.vacant.push(slot);
        }
    }

    /// A random place on a sidewalk where `allowed` lets somebody stand.
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
        let hidden = |p| !avoid.in_sight(scene.ego, p) && avoid.clear_of(scene.near, p);
        let mut place = self.draw_place(hidden);
        if place.is_none()
            && let Some(ego) = scene.ego
        {
            let mut furthest = avoid.start;
            for _ in 0..DRAWS {
                let Some((edge, at)) = self.walks.draw_start(&mut self.rng, &self.network) else { break };
                let Some(lane) = sidewalk(&self.network, edge) else { continue };
                let distance = (ego.xy() - point_on(&self.network, lane, at)).norm();
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
            self.vacant.push(slot);
            return;
        }
        let serial = self.next_serial;
        self.next_serial += 1;
        let id = format!("wad_p{serial}");
        let edge_id = &self.network.edge(edge).id;
        let add = person::Add { edge: edge_id, position: at, person_type: kind.id, ..Default::default() };
        person::add(batch, &id, &add);
        batch.set(person::SET_COLOR, &id, Color::rgb(r, g, b));
        self.slots.insert(id.clone(), slot);
        self.members[slot] = Some(Member { id, serial, speed, end: (edge, at), departed: false });
        self.append(&walks, slot, time, batch);
        self.pending.push(slot);
    }

    /// Walks one after the other from a place on; empty where nobody can walk.
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

    /// Appends walks to a pedestrian's plan, and sees to it that it is looked at before they end.
    fn append(&mut self, walks: &[Walk], slot: usize, time: f64, batch: &mut Batch) {
        let Some(member) = &mut self.members[slot] else { return };
        let mut edges: Vec<&str> = Vec::new();
        for walk in walks {
            edges.clear();
            edges.extend(walk.edges.iter().map(|&e| self.network.edge(e).id.as_str()));
            let stage = person::WalkingStage {
                edges: &edges,
                arrival_position: walk.to,
                speed: member.speed,
                ..Default::default()
            };
            person::append_walking_stage(batch, &member.id, &stage);
            member.end = end_of(walk, member.end.0);
        }
        let length: f64 = walks.iter().map(|w| w.length).sum();
        let lasts = (FOLLOW_UP * length / member.speed - FOLLOW_UP_MARGIN).max(1.0);
        self.schedule.at(time + lasts, slot, member.serial);
    }

    fn read_looks(&mut self, replies: &Replies, scene: Scene<'_>, batch: &mut Batch) {
        let avoid = self.options.avoid;
        for Look { slot, serial, stages, position } in std::mem::take(&mut self.looks) {
            let Some(member) = self.members[slot].as_ref().filter(|m| m.serial == serial) else { continue };
            let (Ok(stages), Ok(position)) = (replies.get(stages), replies.get(position)) else {
                self.schedule.at(scene.time + 1.0, slot, serial);
                continue;
            };
            if stages > 1 {
                // It was held up: its last walk has not begun.
                self.schedule.at(scene.time + 20.0, slot, serial);
                continue;
            }
            let here = Point::new(position.x, position.y);
            let seen = scene.ego.is_some_and(|ego| (ego.xy() - here).norm() < avoid.sight + SIGHT_MARGIN);
            if !seen {
                person::remove(batch, &member.id, RemoveReason::Vaporized);
                self.vacate(slot);
                continue;
            }
            let (edge, at) = member.end;
            let walks = self.draw_walks(edge, at);
            self.append(&walks, slot, scene.time, batch);
        }
    }
}

/// Where a walk from `first` ends.
fn end_of(walk: &Walk, first: EdgeId) -> (EdgeId, f64) {
    (walk.edges.last().copied().unwrap_or(first), walk.to)
}
