//! Pins threads and processes to cores.
//!
//! SUMO and the bridge never run at the same time, and waking another core costs more than the work
//! of a quiet tick, so the two share one core. Linux only; elsewhere nothing happens.

use rayon::prelude::*;
use std::sync::OnceLock;

/// The cores that the process may use, as its first thread with a SUMO found them.
static ALL: OnceLock<Option<Cores>> = OnceLock::new();

/// Lets rayon's workers run on all cores of the process: they inherit the one core of a thread that shares it
/// with SUMO, if that thread is the first to need them.
pub fn free_workers() {
    if let Some(all) = ALL.get_or_init(Cores::allowed) {
        rayon::broadcast(|_| all.confine(0));
    }
}

/// With this many items or more, [`each`] uses all cores.
pub const PARALLEL_FROM: usize = 4;

/// The threads that [`each`] uses for so many items.
pub fn workers(items: usize) -> usize {
    if items < PARALLEL_FROM { 1 } else { rayon::current_num_threads().min(items) }
}

/// `what` for each item, in their order; on all cores where there are many.
pub fn each<T: Send, R: Send>(items: Vec<T>, what: impl Fn(T) -> R + Sync + Send) -> Vec<R> {
    if items.len() < PARALLEL_FROM {
        return items.into_iter().map(what).collect();
    }
    items.into_par_iter().map(what).collect()
}

/// A set of cores.
#[derive(Clone, Copy)]
pub struct Cores(libc::cpu_set_t);

impl Cores {
    /// The cores that this thread may run on.
    pub fn allowed() -> Option<Self> {
        // SAFETY: an all-zero cpu_set_t is the empty set; the call writes one through a live pointer.
        let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
        let size = std::mem::size_of::<libc::cpu_set_t>();
        // SAFETY: as above; pid 0 is this thread.
        let status = unsafe { libc::sched_getaffinity(0, size, &raw mut set) };
        (status == 0).then_some(Self(set))
    }

    /// The core that this thread is on now: the scheduler put it where there was room.
    pub fn current() -> Option<Self> {
        // SAFETY: the call takes and touches nothing.
        let core = usize::try_from(unsafe { libc::sched_getcpu() }).ok()?;
        // SAFETY: an all-zero cpu_set_t is the empty set.
        let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
        if core >= 8 * std::mem::size_of::<libc::cpu_set_t>() {
            return None;
        }
        // SAFETY: `core` is within the set, as just checked.
        unsafe { libc::CPU_SET(core, &mut set) };
        Some(Self(set))
    }

    /// The n-th of the cores that this thread may run on, counted round and round.
    pub fn nth(n: usize) -> Option<Self> {
        let allowed = Self::allowed()?;
        // SAFETY: `core` is within the set, and the set is live.
        let mine = |core: &usize| unsafe { libc::CPU_ISSET(*core, &allowed.0) };
        let cores: Vec<usize> = (0..8 * std::mem::size_of::<libc::cpu_set_t>()).filter(mine).collect();
        let core = *cores.get(n % cores.len().max(1))?;
        // SAFETY: an all-zero cpu_set_t is the empty set.
        let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
        // SAFETY: `core` is within the set, as just checked.
        unsafe { libc::CPU_SET(core, &mut set) };
        Some(Self(set))
    }

    /// These cores without `other`'s; None if none would be left.
    pub fn without(&self, other: &Self) -> Option<Self> {
        // SAFETY: an all-zero cpu_set_t is the empty set.
        let mut rest: libc::cpu_set_t = unsafe { std::mem::zeroed() };
        for core in 0..8 * std::mem::size_of::<libc::cpu_set_t>() {
            // SAFETY: `core` is within the sets, and the sets are live.
            unsafe {
                if libc::CPU_ISSET(core, &self.0) && !libc::CPU_ISSET(core, &other.0) {
                    libc::CPU_SET(core, &mut rest);
                }
            }
        }
        // SAFETY: as above.
        (unsafe { libc::CPU_COUNT(&rest) } > 0).then_some(Self(rest))
    }

    /// Confines a process to these cores; pid 0 is the calling thread. False where the system refuses.
    pub fn confine(&self, pid: u32) -> bool {
        let Ok(pid) = libc::pid_t::try_from(pid) else { return false };
        // SAFETY: the call reads one cpu_set_t through a live pointer.
        unsafe {
            libc::sched_setaffinity(pid, std::mem::size_of::<libc::cpu_set_t>(), &raw const self.0) == 0
        }
    }
}

/// While it lives, this thread and SUMO share a core; afterwards the thread may roam again.
pub struct SharedCore {
    before: Option<Cores>,
}

impl SharedCore {
    /// Puts the calling thread and the process `sumo` on the thread's present core. Threads that the
    /// calling thread starts later inherit that core: start them before, or let them
    /// [`Cores::confine`] themselves elsewhere.
    pub fn with(sumo: u32) -> Self {
        let before = Cores::allowed();
        ALL.get_or_init(|| before);
        if let Some(core) = Cores::current() {
            // SUMO first: where that is refused the thread stays free.
            if core.confine(sumo) {
                core.confine(0);
            }
        }
        Self { before }
    }
}

impl Drop for SharedCore {
    fn drop(&mut self) {
        if let Some(before) = self.before {
            before.confine(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_thread_roams_again_afterwards() {
        // SAFETY: both are plain bit sets read through shared references.
        let count = |cores: &Cores| unsafe { libc::CPU_COUNT(&cores.0) };
        let all = Cores::allowed().unwrap();
        let rest = Cores::nth(0).and_then(|first| all.without(&first));
        assert_eq!(rest.map_or(0, |rest| count(&rest)), count(&all) - 1);
        let before = Cores::allowed().map(|cores| count(&cores));
        let mut child = std::process::Command::new("sleep").arg("10").spawn().unwrap();
        let shared = SharedCore::with(child.id());
        assert_eq!(Cores::allowed().map(|cores| count(&cores)), Some(1));
        drop(shared);
        assert_eq!(Cores::allowed().map(|cores| count(&cores)), before);
        child.kill().unwrap();
        child.wait().unwrap();
    }
}
