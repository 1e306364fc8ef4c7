//! Pins threads and processes to cores.
//!
//! SUMO and the bridge never run at the same time, and waking another core costs more than the work
//! of a quiet tick, so the two share one core, as long as they have it for themselves. Linux only.

use rayon::prelude::*;
use std::sync::OnceLock;
use std::thread::ThreadId;
use std::time::{Duration, Instant};

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

impl PartialEq for Cores {
    fn eq(&self, other: &Self) -> bool {
        // SAFETY: both are plain bit sets read through shared references.
        unsafe { libc::CPU_EQUAL(&self.0, &other.0) }
    }
}

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

/// While it lives, the thread that ticks and SUMO share a core; afterwards the thread may roam again.
///
/// Where others crowd that core (another training's bridge began on it, a compiler runs), both may roam for a moment, so
/// that the scheduler can put them where there is room, and stay there.
pub struct SharedCore {
    /// Where the thread that made it may run without it, and that thread's number.
    before: Option<Cores>,
    maker: u32,
    sumo: u32,
    /// The thread that ticked last.
    thread: ThreadId,
    /// The core that is shared; None while both roam.
    core: Option<Cores>,
    /// When it was last looked at, and how long the thread had waited for its core until then.
    looked: Instant,
    waited: Option<Duration>,
}

impl SharedCore {
    /// Time between two looks whether the core is crowded.
    const LOOK_EVERY: Duration = Duration::from_secs(1);

    /// A core is crowded if this thread waits for it longer than this share of the time.
    const CROWDED: f64 = 0.2;

    /// Puts the calling thread and the process `sumo` on the thread's present core. Threads that the
    /// calling thread starts later inherit that core: start them before, or let them
    /// [`Cores::confine`] themselves elsewhere.
    pub fn with(sumo: u32) -> Self {
        let before = Cores::allowed();
        ALL.get_or_init(|| before);
        let thread = std::thread::current().id();
        // SAFETY: the call takes and touches nothing.
        let maker = unsafe { libc::gettid() }.cast_unsigned();
        let mut shared =
            Self { before, maker, sumo, thread, core: None, looked: Instant::now(), waited: waited() };
        shared.pin();
        shared
    }

    /// Call it before every tick, on the thread that ticks: it moves both where the core is crowded, and SUMO to
    /// the core of a thread that did not tick before, or was free in between ([`Visit`]). Cheap but once a second.
    pub fn settle(&mut self) {
        let thread = std::thread::current().id();
        if self.thread != thread {
            (self.thread, self.looked, self.waited) = (thread, Instant::now(), waited());
            self.free_the_maker();
        }
        if self.core.is_some() && self.core != Cores::allowed() {
            self.pin();
        }
        let since = self.looked.elapsed();
        if since < Self::LOOK_EVERY {
            return;
        }
        let waited = std::mem::replace(&mut self.waited, waited());
        let share = match (waited, self.waited) {
            (Some(before), Some(now)) => now.saturating_sub(before).as_secs_f64() / since.as_secs_f64(),
            _ => 0.0,
        };
        self.looked = Instant::now();
        if self.core.is_none() {
            self.pin();
        } else if share > Self::CROWDED {
            self.roam();
        }
    }

    fn pin(&mut self) {
        // SUMO first: where that is refused the thread stays free.
        self.core = Cores::current().filter(|here| self.core == Some(*here) || here.confine(self.sumo));
        if let Some(core) = self.core {
            core.confine(0);
        }
    }

    /// Another thread ticks now, or nobody: the one that made it would else stay on a core for ever.
    fn free_the_maker(&self) {
        if let Some(before) = self.before {
            before.confine(self.maker);
        }
    }

    fn roam(&mut self) {
        if let Some(before) = self.before {
            before.confine(self.sumo);
            before.confine(0);
        }
        self.core = None;
    }
}

/// While it lives, the thread may share a core with SUMO; afterwards it may run where it could before. For a thread that
/// is not the simulation's own.
pub struct Visit(Option<Cores>);

impl Visit {
    /// It begins.
    pub fn begin() -> Self {
        Self(Cores::allowed())
    }
}

impl Drop for Visit {
    fn drop(&mut self) {
        if let Some(before) = self.0 {
            before.confine(0);
        }
    }
}

/// How long this thread has waited for a core while it could have run; None where the system does not tell.
fn waited() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().nth(1)?.parse().ok().map(Duration::from_nanos)
}

impl Drop for SharedCore {
    fn drop(&mut self) {
        self.free_the_maker();
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
        let rest = Cores::current().and_then(|mine| all.without(&mine));
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

    #[test]
    fn sumo_follows_a_visitor_and_leaves_it_free() {
        let cores = |status: String| {
            let text = std::fs::read_to_string(status).unwrap();
            text.lines().find(|line| line.starts_with("Cpus_allowed_list")).unwrap().to_owned()
        };
        let all = Cores::allowed();
        let mut child = std::process::Command::new("sleep").arg("10").spawn().unwrap();
        // As an environment's own thread makes it, which lives on.
        let id = child.id();
        let (sender, made) = std::sync::mpsc::channel();
        let (again, asked) = std::sync::mpsc::channel();
        let maker = std::thread::spawn(move || {
            sender.send(SharedCore::with(id)).unwrap();
            asked.recv().unwrap();
            Cores::allowed()
        });
        let mut shared = made.recv().unwrap();
        for _ in 0..2 {
            let visit = Visit::begin();
            shared.settle();
            let mine = cores("/proc/thread-self/status".to_owned());
            assert_eq!(cores(format!("/proc/{id}/status")), mine);
            assert!(!mine.contains(['-', ',']), "one core: {mine}");
            drop(visit);
            assert!(Cores::allowed() == all);
        }
        drop(shared);
        again.send(()).unwrap();
        assert!(maker.join().unwrap() == all, "its maker is free again");
        child.kill().unwrap();
        child.wait().unwrap();
    }

    #[test]
    fn a_crowded_core_is_left() {
        // SAFETY: a plain bit set read through a shared reference.
        let count = |cores: Option<Cores>| cores.map(|cores| unsafe { libc::CPU_COUNT(&cores.0) });
        let all = Cores::allowed();
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let mut shared = SharedCore::with(child.id());
        let over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            // It inherits the core.
            scope.spawn(|| {
                while !over.load(std::sync::atomic::Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
            let begun = Instant::now();
            while count(Cores::allowed()) != count(all) && begun.elapsed() < Duration::from_secs(50) {
                shared.settle();
            }
            over.store(true, std::sync::atomic::Ordering::Relaxed);
        });
        assert_eq!(count(Cores::allowed()), count(all));
        drop(shared);
        child.kill().unwrap();
        child.wait().unwrap();
    }
}
