//! The slots of a population: each is filled by a member, and filled again when that one is gone.

use super::schedule::Schedule;
use std::collections::HashMap;

/// A vehicle or pedestrian that was added to SUMO.
#[derive(Debug)]
pub(super) struct Member<T> {
    pub id: String,
    /// No two members of a population share it.
    pub serial: u64,
    pub departed: bool,
    pub about: T,
}

#[derive(Debug)]
pub(super) struct Slots<T> {
    members: Vec<Option<Member<T>>>,
    /// Slots by SUMO's id; looked up only, never walked through.
    by_id: HashMap<String, usize>,
    /// Slots whose member SUMO has not put into the network yet.
    pending: Vec<usize>,
    /// Slots to be filled.
    pub vacant: Vec<usize>,
    /// Slots that are to stay empty since the population was made smaller.
    retired: Vec<usize>,
    /// When to check which member.
    pub schedule: Schedule,
    next_serial: u64,
    alive: usize,
    /// Members that were in the network and were taken out: SUMO does not say that they arrive.
    pub taken_out: usize,
}

impl<T> Default for Slots<T> {
    fn default() -> Self {
        Self {
            members: Vec::new(),
            by_id: HashMap::new(),
            pending: Vec::new(),
            vacant: Vec::new(),
            retired: Vec::new(),
            schedule: Schedule::default(),
            next_serial: 0,
            alive: 0,
            taken_out: 0,
        }
    }
}

impl<T> Slots<T> {
    /// How many were in the network after the last [`Slots::follow`].
    pub fn alive(&self) -> usize {
        self.alive
    }

    /// Whether there is no slot.
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// The slot of the member `id`.
    pub fn find(&self, id: &str) -> Option<usize> {
        self.by_id.get(id).copied()
    }

    /// The member in a slot.
    pub fn get(&self, slot: usize) -> Option<&Member<T>> {
        self.members.get(slot)?.as_ref()
    }

    pub fn get_mut(&mut self, slot: usize) -> Option<&mut Member<T>> {
        self.members.get_mut(slot)?.as_mut()
    }

    /// The member with this number, where it still fills the slot.
    pub fn with_serial(&self, slot: usize, serial: u64) -> Option<&Member<T>> {
        self.get(slot).filter(|member| member.serial == serial)
    }

    /// A new slot, empty, not yet vacant.
    pub fn add(&mut self) -> usize {
        self.members.push(None);
        self.members.len() - 1
    }

    /// Fills a slot with a member called `prefix` and its number; that number.
    pub fn fill(&mut self, slot: usize, prefix: &str, about: T) -> u64 {
        let serial = self.next_serial;
        self.next_serial += 1;
        let id = format!("{prefix}{serial}");
        self.by_id.insert(id.clone(), slot);
        self.members[slot] = Some(Member { id, serial, departed: false, about });
        self.pending.push(slot);
        serial
    }

    /// Empties a slot, to be filled in this tick.
    pub fn vacate(&mut self, slot: usize) {
        if let Some(member) = self.members[slot].take() {
            self.by_id.remove(&member.id);
            self.vacant.push(slot);
        }
    }

    /// Empties a slot whose member `remove` takes out of SUMO.
    pub fn evict(&mut self, slot: usize, remove: impl FnOnce(&str)) {
        if let Some(member) = &self.members[slot] {
            remove(&member.id);
            self.taken_out += usize::from(member.departed);
        }
        self.pending.retain(|&pending| pending != slot);
        self.vacate(slot);
    }

    /// Keeps `count` slots from now on: `remove` takes the last members out, or new ones are vacant.
    pub fn resize(&mut self, count: usize, mut remove: impl FnMut(&str)) {
        let kept = self.members.len() - self.retired.len();
        for _ in count..kept {
            let Some(slot) = (0..self.members.len()).rev().find(|slot| !self.retired.contains(slot)) else {
                break;
            };
            self.evict(slot, &mut remove);
            self.vacant.retain(|&vacant| vacant != slot);
            self.retired.push(slot);
        }
        for _ in kept..count {
            let slot = self.retired.pop().unwrap_or_else(|| self.add());
            self.vacant.push(slot);
        }
    }

    /// Updates the slots after a step with its departures and arrivals; calls `refused` for members that SUMO did
    /// not insert.
    pub fn follow(&mut self, departed: &[&str], arrived: &[&str], mut refused: impl FnMut(&Member<T>)) {
        for slot in arrived.iter().filter_map(|id| self.find(id)).collect::<Vec<_>>() {
            self.vacate(slot);
        }
        for id in departed {
            if let Some(member) = self.find(id).and_then(|slot| self.get_mut(slot)) {
                member.departed = true;
            }
        }
        for slot in std::mem::take(&mut self.pending) {
            if let Some(member) = self.get(slot).filter(|member| !member.departed) {
                refused(member);
                self.vacate(slot);
            }
        }
        self.alive = self.members.iter().flatten().filter(|member| member.departed).count();
    }
}
