//! A million transitions: latents, never images, each observation stored once.
//!
//! Experience comes in [`Segment`]s: up to a few dozen transitions of one episode in a row, and the
//! observation after the last. A transition's next observation is the following entry; the last entry
//! of a segment has no action and is never drawn itself. One entry in sixty-five is such an extra.
//!
//! | what | bytes per entry |
//! |---|---|
//! | latent, 200 in half precision (three decimal digits) | 400 |
//! | raw vector, 15 | 60 |
//! | action, 3; what an expert would have done, 3; reward; flags | 29 |
//! | place, and its list of entries | 8 |
//!
//! A million transitions take 505 MB.

use super::action::{ACTION_SIZE, Action};
use super::exploration::normals;
use super::networks::Dims;
use super::places::{Place, Visits};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rand::{Rng, RngExt};
use std::collections::VecDeque;

/// Transitions of one episode in a row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Segment {
    /// Latent and raw vector of each observation: one more than there are transitions.
    pub observations: Vec<Vec<f32>>,
    /// The action of each transition.
    pub actions: Vec<Action>,
    /// The reward of each transition, not scaled.
    pub rewards: Vec<f32>,
    /// The last transition ended the task: the value of the next state is 0.
    pub terminated: bool,
    /// The clock ended the episode: the last transition still bootstraps.
    pub truncated: bool,
    /// The expert's action in place of each action; None or missing: the expert was not asked.
    pub shown: Vec<Option<Action>>,
    /// Where each transition began; missing: not known.
    pub places: Vec<Place>,
    /// Where the transitions of the same episode just before the segment began, oldest first, [`NEAR`] at most: other egos'
    /// segments lie between those of an episode.
    pub lead: Vec<Place>,
}

/// Transitions per segment at most.
pub const SEGMENT: usize = 64;

impl Segment {
    /// Number of transitions.
    pub fn len(&self) -> usize {
        self.actions.len()
    }

    /// Whether it has no transitions.
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    /// The places of the last [`NEAR`] transitions up to its end, those before the segment included.
    pub fn way(&self) -> Vec<Place> {
        let all = self.lead.len() + self.places.len();
        self.lead.iter().chain(&self.places).skip(all.saturating_sub(NEAR)).copied().collect()
    }
}

/// Why the buffer cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BufferError {
    /// The buffer does not fit into the memory.
    #[error(
        "a replay buffer of {transitions} transitions takes {needed_mb} MB, and {available_mb} MB of memory are free; \
         make it smaller with --buffer"
    )]
    Memory {
        /// The wanted size (transitions).
        transitions: usize,
        /// Memory that it needs (MB).
        needed_mb: u64,
        /// Free memory (MB).
        available_mb: u64,
    },
    /// The buffer is too small to learn from.
    #[error(
        "a replay buffer needs at least {least} transitions, found {found}; make it larger with --buffer"
    )]
    TooSmall {
        /// The wanted size (transitions).
        found: usize,
        /// The smallest size (transitions).
        least: usize,
    },
}

/// What an entry is.
pub(crate) mod flag {
    /// No action: only the next observation of the entry before.
    pub const END: u8 = 1;
    pub const TERMINATED: u8 = 2;
    pub const TRUNCATED: u8 = 4;
    /// An expert's action is there too.
    pub const SHOWN: u8 = 8;
}

/// How batches are sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Transitions per batch.
    pub batch_size: usize,
    /// Rewards summed before the critic's estimate is used (n-step return).
    pub n_step: usize,
    /// Discount per tick.
    pub gamma: f64,
    /// Factor on the rewards.
    pub reward_scale: f64,
    /// Share of the transitions drawn where episodes end, 0 to 1; the others are drawn uniformly. All transitions at the
    /// places of the last [`NEAR`] before a termination count, whatever came of them: to draw by the outcome would
    /// have critics expect it more often than it comes.
    pub near_ends: f64,
}

/// How many transitions before a termination lead to it: about seven seconds, in which it can still be averted.
pub const NEAR: usize = 40;

/// A sample of the buffer.
#[derive(Clone, Debug, Default)]
pub struct Sampled {
    /// Number of batches, K.
    pub batches: usize,
    /// B
    pub size: usize,
    /// [K, 2, B, latent]
    pub latents: Vec<f16>,
    /// [K, 2, B, raw]
    pub raw: Vec<f32>,
    /// [K, B, 3 A + 3]: action, noise, reward, discount, whether an expert's action is there, and that.
    pub rest: Vec<f32>,
}

/// The buffer: a ring of entries.
#[derive(Debug)]
pub struct ReplayBuffer {
    pub(crate) dims: Dims,
    pub(crate) latents: Vec<f16>,
    pub(crate) raw: Vec<f32>,
    pub(crate) actions: Vec<f32>,
    pub(crate) shown: Vec<f32>,
    pub(crate) rewards: Vec<f32>,
    pub(crate) flags: Vec<u8>,
    pub(crate) places: Vec<Place>,
    visits: Visits,
    capacity: usize,
    /// Entries ever written.
    pub(crate) written: u64,
    /// The entries that are terminations, oldest first, each with the places that lead to it.
    terminations: VecDeque<(usize, Vec<Place>)>,
}

/// Smallest buffer (transitions).
const LEAST: usize = 1024;

impl ReplayBuffer {
    /// An empty buffer for `transitions` transitions. Memory is allocated as it fills, but whether it will
    /// fit is checked now.
    ///
    /// # Errors
    /// It would not fit into memory, or is too small to learn from.
    pub fn new(dims: Dims, transitions: usize) -> Result<Self, BufferError> {
        if transitions < LEAST {
            return Err(BufferError::TooSmall { found: transitions, least: LEAST });
        }
        let capacity = entries(transitions);
        let needed = capacity as u64 * Self::bytes_per_entry(dims);
        let available = available_memory();
        let too_large = || BufferError::Memory {
            transitions,
            needed_mb: needed / 1_000_000,
            available_mb: available.unwrap_or(0) / 1_000_000,
        };
        if available.is_some_and(|available| needed > available) {
            return Err(too_large());
        }
        // `vec![0; n]` takes zero pages from the system as they are touched, but aborts where there are
        // none; this asks first.
        let mut probe: Vec<u8> = Vec::new();
        probe.try_reserve_exact(needed as usize).map_err(|_| too_large())?;
        drop(probe);
        let a = dims.actions as usize;
        Ok(Self {
            dims,
            latents: vec![f16::ZERO; capacity * dims.latent as usize],
            raw: vec![0.0; capacity * dims.raw as usize],
            actions: vec![0.0; capacity * a],
            shown: vec![0.0; capacity * a],
            rewards: vec![0.0; capacity],
            flags: vec![flag::END; capacity],
            places: vec![Place::UNKNOWN; capacity],
            visits: Visits::default(),
            capacity,
            written: 0,
            terminations: VecDeque::new(),
        })
    }

    /// Bytes that an entry takes.
    pub fn bytes_per_entry(dims: Dims) -> u64 {
        (2 * dims.latent + 4 * (dims.raw + 2 * dims.actions + 2) + 1) as u64
    }

    /// Capacity (entries).
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Number of entries, including ends of segments.
    pub fn len(&self) -> usize {
        self.written.min(self.capacity as u64) as usize
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.written == 0
    }

    /// Adds a segment; it replaces the oldest entries of a full buffer.
    ///
    /// # Panics
    /// The segment's parts do not fit together.
    pub fn push(&mut self, segment: &Segment) {
        let n = segment.len();
        assert_eq!((segment.observations.len(), segment.rewards.len()), (n + 1, n), "a segment's parts");
        for i in 0..=n {
            let at = (self.written % self.capacity as u64) as usize;
            let (latent, raw) = (self.dims.latent as usize, self.dims.raw as usize);
            let observation = &segment.observations[i];
            assert_eq!(observation.len(), latent + raw, "an observation's numbers");
            self.latents[at * latent..][..latent].convert_from_f32_slice(&observation[..latent]);
            self.raw[at * raw..][..raw].copy_from_slice(&observation[latent..latent + raw]);
            if self.terminations.front().is_some_and(|(end, _)| *end == at) {
                self.terminations.pop_front();
            }
            self.visits.forget(self.places[at], at);
            self.places[at] = Place::UNKNOWN;
            self.flags[at] = flag::END;
            if i < n {
                self.places[at] = segment.places.get(i).copied().unwrap_or_default();
                self.visits.add(self.places[at], at);
                let a = self.dims.actions as usize;
                debug_assert!(a <= ACTION_SIZE);
                self.actions[at * a..][..a].copy_from_slice(&segment.actions[i][..a]);
                self.rewards[at] = segment.rewards[i];
                self.flags[at] = 0;
                if let Some(Some(shown)) = segment.shown.get(i) {
                    self.shown[at * a..][..a].copy_from_slice(&shown[..a]);
                    self.flags[at] = flag::SHOWN;
                }
                if i + 1 == n {
                    self.flags[at] |= if segment.terminated { flag::TERMINATED } else { 0 };
                    self.flags[at] |= if segment.truncated { flag::TRUNCATED } else { 0 };
                    if segment.terminated {
                        self.terminations.push_back((at, segment.way()));
                    }
                }
            }
            self.written += 1;
        }
    }

    /// The places that lead to each termination, oldest first.
    pub(crate) fn leads(&self) -> Vec<Vec<Place>> {
        self.terminations.iter().map(|(_, lead)| lead.clone()).collect()
    }

    /// Finds the terminations and places among entries that were written from outside; what leads to the terminations is
    /// given, oldest first.
    pub(crate) fn index(&mut self, leads: Vec<Vec<Place>>) {
        let oldest = (self.written % self.capacity as u64) as usize;
        let oldest = if self.len() == self.capacity { oldest } else { 0 };
        self.terminations.clear();
        self.visits.clear();
        let mut leads = leads.into_iter();
        for at in (0..self.len()).map(|i| (oldest + i) % self.capacity) {
            self.visits.add(self.places[at], at);
            if self.flags[at] & flag::TERMINATED != 0 {
                self.terminations.push_back((at, leads.next().unwrap_or_default()));
            }
        }
    }

    /// Draws `batches` batches with the noise of their updates.
    ///
    /// # Panics
    /// The buffer holds no transition.
    pub fn sample(&self, rng: &mut impl Rng, sampling: Sampling, batches: usize, out: &mut Sampled) {
        assert!(!self.is_empty(), "nothing to sample from");
        let (latent, raw, a) =
            (self.dims.latent as usize, self.dims.raw as usize, self.dims.actions as usize);
        let b = sampling.batch_size;
        out.batches = batches;
        out.size = b;
        out.latents.resize(batches * 2 * b * latent, f16::ZERO);
        out.raw.resize(batches * 2 * b * raw, 0.0);
        let width = 3 * a + 3;
        out.rest.resize(batches * b * width, 0.0);
        for k in 0..batches {
            for i in 0..b {
                let at = self.draw(rng, sampling.near_ends);
                let (reward, discount, next) = self.ahead(at, sampling);
                for (half, entry) in [at, next].into_iter().enumerate() {
                    let row = (k * 2 + half) * b + i;
                    out.latents[row * latent..][..latent]
                        .copy_from_slice(&self.latents[entry * latent..][..latent]);
                    out.raw[row * raw..][..raw].copy_from_slice(&self.raw[entry * raw..][..raw]);
                }
                let rest = &mut out.rest[(k * b + i) * width..][..width];
                rest[..a].copy_from_slice(&self.actions[at * a..][..a]);
                normals(rng, &mut rest[a..2 * a]);
                rest[2 * a] = (reward * sampling.reward_scale) as f32;
                rest[2 * a + 1] = discount as f32;
                rest[2 * a + 2] = f32::from(u8::from(self.flags[at] & flag::SHOWN != 0));
                rest[2 * a + 3..].copy_from_slice(&self.shown[at * a..][..a]);
            }
        }
    }

    /// An entry with an action.
    fn draw(&self, rng: &mut impl Rng, near_ends: f64) -> usize {
        let ends = &self.terminations;
        if near_ends > 0.0 && !ends.is_empty() && rng.random_bool(near_ends) {
            let (_, lead) = &ends[rng.random_range(0..ends.len())];
            // Missing where places are not known.
            let place = lead.get(rng.random_range(0..lead.len().max(1))).copied().unwrap_or(Place::UNKNOWN);
            if let Some(visits) = self.visits.at(place) {
                return visits[rng.random_range(0..visits.len())] as usize;
            }
        }
        loop {
            let at = rng.random_range(0..self.len());
            if self.flags[at] & flag::END == 0 {
                return at;
            }
        }
    }

    /// The discounted sum of the next rewards, the discount of the next value (0 after a termination), and
    /// the entry of that value.
    fn ahead(&self, from: usize, sampling: Sampling) -> (f64, f64, usize) {
        let (mut sum, mut discount, mut at) = (0.0, 1.0, from);
        for _ in 0..sampling.n_step.max(1) {
            if self.flags[at] & flag::END != 0 {
                break;
            }
            sum += discount * f64::from(self.rewards[at]);
            discount *= sampling.gamma;
            let terminated = self.flags[at] & flag::TERMINATED != 0;
            at = (at + 1) % self.capacity;
            if terminated {
                return (sum, 0.0, at);
            }
        }
        (sum, discount, at)
    }

    /// Mean and standard deviation of each number of the stored observations, over at most `samples` of
    /// them, evenly spread.
    pub fn moments(&self, samples: usize) -> (Vec<f32>, Vec<f32>) {
        let (latent, raw) = (self.dims.latent as usize, self.dims.raw as usize);
        let (mut sum, mut squares) = (vec![0.0; latent + raw], vec![0.0; latent + raw]);
        let stride = (self.len() / samples.max(1)).max(1);
        let mut n = 0.0;
        for at in (0..self.len()).step_by(stride) {
            n += 1.0;
            let latents = self.latents[at * latent..][..latent].iter().map(|x| x.to_f64());
            let raws = self.raw[at * raw..][..raw].iter().map(|x| f64::from(*x));
            for (i, x) in latents.chain(raws).enumerate() {
                sum[i] += x;
                squares[i] += x * x;
            }
        }
        let n = f64::max(n, 1.0);
        let mean: Vec<f64> = sum.iter().map(|s| s / n).collect();
        let deviation =
            mean.iter().zip(&squares).map(|(m, s)| (s / n - m * m).max(0.0).sqrt() as f32).collect();
        (mean.into_iter().map(|m| m as f32).collect(), deviation)
    }
}

/// Entries for that many transitions, ends of segments included.
fn entries(transitions: usize) -> usize {
    transitions + transitions.div_ceil(SEGMENT)
}

/// Free memory for this process (bytes); None if the system does not report it.
pub fn available_memory() -> Option<u64> {
    let info = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = info.lines().find(|line| line.starts_with("MemAvailable:"))?;
    let free = line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024;
    let read = |name: &str| {
        let text = std::fs::read_to_string(format!("/sys/fs/cgroup/{name}")).ok()?;
        text.trim().parse::<u64>().ok()
    };
    let group = read("memory.max").zip(read("memory.current")).map(|(max, now)| max.saturating_sub(now));
    Some(group.map_or(free, |group| group.min(free)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::seeds;

    const DIMS: Dims = Dims { latent: 2, raw: 1, actions: 3 };
    const PLAIN: Sampling =
        Sampling { batch_size: 512, n_step: 1, gamma: 0.5, reward_scale: 1.0, near_ends: 0.0 };

    /// Observation k is [k, -k, k / 2], its action [k / 1000, 0, 0], its reward k.
    fn segment(from: usize, n: usize, terminated: bool) -> Segment {
        let value = |k: usize| (from + k) as f32;
        Segment {
            observations: (0..=n).map(|k| vec![value(k), -value(k), value(k) / 2.0]).collect(),
            actions: (0..n).map(|k| [value(k) / 1000.0, 0.0, 0.0]).collect(),
            rewards: (0..n).map(value).collect(),
            terminated,
            truncated: !terminated,
            shown: (0..n).map(|k| (from == 0).then(|| [value(k) / 2000.0, 0.0, 0.0])).collect(),
            ..Segment::default()
        }
    }

    fn rows(buffer: &ReplayBuffer, sampling: Sampling) -> Vec<[f32; 5]> {
        let mut out = Sampled::default();
        buffer.sample(&mut seeds::rng(1, "test"), sampling, 2, &mut out);
        let b = sampling.batch_size;
        let mut rows = Vec::new();
        for k in 0..2 {
            for i in 0..b {
                let now = out.latents[((k * 2) * b + i) * 2].to_f32();
                let next = out.latents[((k * 2 + 1) * b + i) * 2].to_f32();
                assert_eq!(out.raw[(k * 2) * b + i], now / 2.0);
                let rest = &out.rest[(k * b + i) * 12..][..12];
                assert_eq!(rest[0], now / 1000.0);
                assert!(rest[8] == 0.0 || rest[9] == now / 2000.0, "the expert's own action");
                rows.push([now, next, rest[6], rest[7], rest[8]]);
            }
        }
        rows
    }

    #[test]
    fn every_transition_is_drawn_with_its_own_next_and_no_end_is() {
        let mut buffer = ReplayBuffer::new(DIMS, 1024).unwrap();
        buffer.push(&segment(0, 10, true));
        buffer.push(&segment(100, 5, false));
        assert_eq!(buffer.len(), 17);
        let mut seen = std::collections::BTreeSet::new();
        for [now, next, reward, discount, shown] in rows(&buffer, PLAIN) {
            assert_eq!((next, reward), (now + 1.0, now));
            assert_eq!(
                discount,
                if now == 9.0 { 0.0 } else { 0.5 },
                "only the terminated end is worth nothing"
            );
            assert_eq!(shown, if now < 100.0 { 1.0 } else { 0.0 });
            seen.insert(now as usize);
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), (0..10).chain(100..105).collect::<Vec<_>>());
    }

    #[test]
    #[should_panic(expected = "an observation's numbers")]
    fn observations_of_other_inputs_are_not_cut_to_size() {
        let mut other = segment(0, 10, true);
        other.observations[3].push(7.0);
        ReplayBuffer::new(DIMS, 1024).unwrap().push(&other);
    }

    #[test]
    fn the_ring_forgets_the_oldest_and_never_joins_strangers() {
        let mut buffer = ReplayBuffer::new(DIMS, 1024).unwrap();
        for episode in 0..100 {
            buffer.push(&segment(20 * episode + 1, 17, episode % 2 == 0));
        }
        assert_eq!(buffer.len(), buffer.capacity());
        let rows = rows(&buffer, PLAIN);
        assert!(rows.iter().all(|[now, next, ..]| *next == now + 1.0));
        let oldest = rows.iter().map(|row| row[0] as usize).min().unwrap();
        assert!(oldest > 20 * (100 - buffer.capacity() / 18 - 2), "{oldest} should have been forgotten");
    }

    #[test]
    fn rewards_of_several_steps_stop_at_ends() {
        let mut buffer = ReplayBuffer::new(DIMS, 1024).unwrap();
        buffer.push(&segment(0, 10, true));
        buffer.push(&segment(100, 5, false));
        for [now, next, reward, discount, _] in rows(&buffer, Sampling { n_step: 3, ..PLAIN }) {
            let end = if now < 100.0 { 10.0 } else { 105.0 };
            let n = (end - now).min(3.0) as i32;
            let sum: f32 = (0..n).map(|k| 0.5_f32.powi(k) * (now + k as f32)).sum();
            assert_eq!((next, reward), (now + n as f32, sum));
            let terminated = next == 10.0;
            assert_eq!(discount, if terminated { 0.0 } else { 0.5_f32.powi(n) });
        }
    }

    #[test]
    fn the_share_near_ends_is_drawn_from_all_that_was_driven_there() {
        let mut buffer = ReplayBuffer::new(DIMS, 1024).unwrap();
        // Every tenth episode drives at another place than the rest, and half of those end there.
        let driven = |episode: usize| {
            let place = Place(if episode.is_multiple_of(10) { 8 } else { 7 });
            let part = segment(20 * episode + 1, 17, episode.is_multiple_of(20));
            Segment { places: vec![place; 17], ..part }
        };
        for episode in 0..100 {
            buffer.push(&driven(episode));
        }
        let sampling = Sampling { near_ends: 0.5, ..PLAIN };
        let episodes: Vec<usize> = rows(&buffer, sampling).iter().map(|row| row[0] as usize / 20).collect();
        let share = |at: &dyn Fn(usize) -> bool| {
            episodes.iter().filter(|e| at(**e)).count() as f64 / episodes.len() as f64
        };
        // What lies before an end in the ring is other episodes', which drove elsewhere.
        let there = share(&|e| e.is_multiple_of(10));
        assert!((0.5..0.6).contains(&there), "expected 0.5 + 0.5 * 0.1, found {there}");
        let ended = share(&|e| e.is_multiple_of(20)) / there;
        assert!((0.35..0.65).contains(&ended), "expected half of them to have ended there, found {ended}");
        // The same after a resume.
        let before = rows(&buffer, sampling);
        buffer.index(buffer.leads());
        assert_eq!(before, rows(&buffer, sampling));
    }

    #[test]
    fn what_leads_to_an_end_is_its_own_episodes_also_where_others_lie_between() {
        let mut buffer = ReplayBuffer::new(DIMS, 1024).unwrap();
        let at = |place: u32, part: Segment| Segment { places: vec![Place(place); part.len()], ..part };
        // An episode in two segments, with another ego's between.
        let first = at(7, Segment { truncated: false, ..segment(1, 50, false) });
        let lead = first.way();
        assert_eq!(lead.len(), NEAR, "no more are kept");
        buffer.push(&first);
        buffer.push(&at(8, segment(101, 60, false)));
        let last = Segment { lead, ..at(9, segment(201, 10, true)) };
        assert_eq!(last.way(), [vec![Place(7); 30], vec![Place(9); 10]].concat());
        buffer.push(&last);
        let near = rows(&buffer, Sampling { near_ends: 1.0, ..PLAIN });
        let share = |range: std::ops::Range<f32>| {
            near.iter().filter(|row| range.contains(&row[0])).count() as f64 / near.len() as f64
        };
        assert_eq!(share(101.0..162.0), 0.0, "the other ego ended nothing");
        assert!((0.65..0.85).contains(&share(1.0..51.0)), "expected 30 of 40");
    }

    #[test]
    fn where_places_are_not_known_all_is_drawn_alike() {
        let mut buffer = ReplayBuffer::new(DIMS, 1024).unwrap();
        for episode in 0..40 {
            buffer.push(&segment(20 * episode + 1, 17, episode == 0));
        }
        let rows = rows(&buffer, Sampling { near_ends: 1.0, ..PLAIN });
        let share = rows.iter().filter(|row| row[0] < 20.0).count() as f64 / rows.len() as f64;
        assert!(share < 0.08, "expected a fortieth, found {share}");
    }

    #[test]
    fn a_million_transitions_take_less_than_a_gigabyte() {
        let bytes = entries(1_000_000) as u64 * ReplayBuffer::bytes_per_entry(Dims::DRIVING);
        assert!(bytes < 505_000_000, "{bytes}");
    }

    #[test]
    fn a_buffer_beyond_memory_says_so() {
        let error = ReplayBuffer::new(Dims::DRIVING, 1 << 40).unwrap_err().to_string();
        assert!(error.contains("MB of memory are free") && error.contains("--buffer"), "{error}");
    }
}
