//! State shared by simulation, artist and server.

use super::protocol::{Request, State};
use super::wheel::Wanted;
use crate::camera::Preset;
use crate::criteria::EgoOnRoute;
use crate::eyes::Look;
use crate::network::Route;
use crate::world::{Actor, WorldState};
use bytes::Bytes;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};

/// Silence of a driver's browser after which it counts as gone: it answers pings even while its page is busy.
pub const GRIP: Duration = Duration::from_millis(800);
/// Time without controls from the page: after the first the pedals are released, after the second the wheel.
const BUSY: Duration = Duration::from_millis(800);
const HUNG: Duration = Duration::from_secs(3);
/// Ticks of the plots that a new page gets.
const HISTORY: usize = 900;
/// Most requests that wait for the next tick.
const WAITING: usize = 256;

/// Everything to show of one tick.
pub struct Shot {
    pub state: State,
    pub world: WorldState,
    /// As seen from outside.
    pub ego: Actor,
    pub weather: Preset,
    /// The driver's frame; None for a blind driver.
    pub look: Option<Look>,
    /// The input of perception for a blind driver; None: no perception.
    pub way: Option<(Arc<Route>, EgoOnRoute)>,
}

/// A message for all viewers.
pub struct Packet {
    pub route_id: u64,
    pub bytes: Bytes,
}

/// One tick of the plots: time, speed, limit, the six terms.
pub type Point = [f32; 9];

/// See the module.
pub struct Hub {
    /// The first message to each viewer: what is shown.
    hello: Mutex<serde_json::Value>,
    map: Mutex<Bytes>,
    slot: Mutex<Option<Shot>>,
    ready: Condvar,
    pub packets: watch::Sender<Option<Arc<Packet>>>,
    requests: mpsc::Sender<(u64, Request)>,
    grip: Mutex<Option<Grip>>,
    route: Mutex<(u64, String)>,
    history: Mutex<VecDeque<Point>>,
    viewers: AtomicUsize,
    chase: AtomicUsize,
    stages: AtomicUsize,
    next_viewer: AtomicU64,
    over: AtomicBool,
    artist: AtomicU64,
    /// Number of the shown run or episode.
    pub greeting: watch::Sender<u64>,
    /// Why what a viewer asked for was not done; for all viewers.
    pub refusal: watch::Sender<String>,
    pub closing: watch::Sender<bool>,
}

#[derive(Clone, Copy, Debug)]
struct Grip {
    viewer: u64,
    wanted: Wanted,
    /// Times of the browser's last message and of the page's last controls.
    seen: Instant,
    told: Instant,
}

/// The wheel before a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hands {
    /// No viewer holds it.
    Off,
    /// A viewer holds it, with these controls.
    On(u64, Wanted),
    /// The viewer that held it has gone.
    Lost(u64),
}

/// Locks, ignoring poison.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    pub fn new() -> (Arc<Self>, mpsc::Receiver<(u64, Request)>) {
        let (requests, receiver) = mpsc::channel(WAITING);
        let hub = Self {
            hello: Mutex::default(),
            map: Mutex::default(),
            slot: Mutex::default(),
            ready: Condvar::new(),
            packets: watch::Sender::new(None),
            requests,
            grip: Mutex::default(),
            route: Mutex::new((0, String::new())),
            history: Mutex::default(),
            viewers: AtomicUsize::new(0),
            chase: AtomicUsize::new(0),
            stages: AtomicUsize::new(0),
            next_viewer: AtomicU64::new(1),
            over: AtomicBool::new(false),
            artist: AtomicU64::new(0),
            greeting: watch::Sender::new(0),
            refusal: watch::Sender::new(String::new()),
            closing: watch::Sender::new(false),
        };
        (Arc::new(hub), receiver)
    }

    /// Hands a shot to the artist; it replaces one that is still waiting.
    pub fn show(&self, shot: Shot) {
        *lock(&self.slot) = Some(shot);
        self.ready.notify_one();
    }

    /// The next shot for the artist of that number; None at the end, or if another artist draws.
    pub fn next_shot(&self, artist: u64) -> Option<Shot> {
        let mut slot = lock(&self.slot);
        loop {
            if self.over.load(Ordering::Acquire) || self.artist.load(Ordering::Acquire) != artist {
                return None;
            }
            if let Some(shot) = slot.take() {
                return Some(shot);
            }
            slot = self.ready.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Begins the turn of another artist: returns its number.
    pub fn another_artist(&self) -> u64 {
        let _slot = lock(&self.slot);
        let number = self.artist.fetch_add(1, Ordering::AcqRel) + 1;
        self.ready.notify_all();
        number
    }

    /// Sends every viewer again what is shown.
    pub fn greet_again(&self) {
        self.greeting.send_modify(|n| *n += 1);
    }

    /// Ends artist and server.
    pub fn close(&self) {
        let slot = lock(&self.slot);
        self.over.store(true, Ordering::Release);
        self.ready.notify_all();
        drop(slot);
        self.closing.send_replace(true);
    }

    pub fn viewers(&self) -> usize {
        self.viewers.load(Ordering::Relaxed)
    }

    pub fn wants_chase(&self) -> bool {
        self.chase.load(Ordering::Relaxed) > 0
    }

    pub fn wants_stages(&self) -> bool {
        self.stages.load(Ordering::Relaxed) > 0
    }

    /// The route's line for the page, under a number that changes with the route.
    pub fn set_route(&self, id: u64, json: String) {
        *lock(&self.route) = (id, json);
    }

    pub fn route(&self) -> (u64, String) {
        lock(&self.route).clone()
    }

    pub fn remember(&self, point: Point) {
        let mut history = lock(&self.history);
        if history.len() == HISTORY {
            history.pop_front();
        }
        history.push_back(point);
    }

    pub fn history(&self) -> Vec<Point> {
        lock(&self.history).iter().copied().collect()
    }

    pub fn forget_history(&self) {
        lock(&self.history).clear();
    }

    pub fn set_hello(&self, hello: serde_json::Value) {
        *lock(&self.hello) = hello;
    }

    pub fn hello(&self) -> serde_json::Value {
        lock(&self.hello).clone()
    }

    pub fn set_map(&self, map: String) {
        *lock(&self.map) = Bytes::from(map);
    }

    pub fn map(&self) -> Bytes {
        lock(&self.map).clone()
    }

    /// Gives the wheel to a viewer. False if another viewer has it.
    pub fn take_wheel(&self, viewer: u64) -> bool {
        let mut grip = lock(&self.grip);
        if grip.is_some_and(|grip| grip.viewer != viewer) {
            return false;
        }
        let now = Instant::now();
        *grip = Some(Grip { viewer, wanted: Wanted::default(), seen: now, told: now });
        true
    }

    pub fn leave_wheel(&self) {
        *lock(&self.grip) = None;
    }

    /// The viewer who has the wheel at this moment, also while no tick comes.
    pub fn holder(&self) -> Option<u64> {
        lock(&self.grip).filter(|grip| !grip.is_lost()).map(|grip| grip.viewer)
    }

    /// The wheel's wanted position. A viewer who has gone loses the wheel.
    pub fn hands(&self) -> Hands {
        let mut grip = lock(&self.grip);
        match *grip {
            None => Hands::Off,
            Some(lost) if lost.is_lost() => {
                *grip = None;
                Hands::Lost(lost.viewer)
            }
            Some(Grip { viewer, told, .. }) if told.elapsed() > BUSY => Hands::On(viewer, Wanted::default()),
            Some(Grip { viewer, wanted, .. }) => Hands::On(viewer, wanted),
        }
    }
}

impl Grip {
    /// Whether the viewer has gone, or says nothing.
    fn is_lost(&self) -> bool {
        self.seen.elapsed() > GRIP || self.told.elapsed() > HUNG
    }
}

/// A viewer, for as long as its connection lasts.
pub struct Viewer {
    pub id: u64,
    hub: Arc<Hub>,
    look: (bool, bool),
}

impl Viewer {
    pub fn join(hub: &Arc<Hub>) -> Self {
        hub.viewers.fetch_add(1, Ordering::Relaxed);
        Self {
            id: hub.next_viewer.fetch_add(1, Ordering::Relaxed),
            hub: Arc::clone(hub),
            look: (false, false),
        }
    }

    /// Notes a sign of life, e.g. the answer to a ping.
    pub fn is_there(&self) {
        if let Some(grip) = lock(&self.hub.grip).as_mut().filter(|grip| grip.viewer == self.id) {
            grip.seen = Instant::now();
        }
    }

    /// Whether it drives.
    pub fn drives(&self) -> bool {
        lock(&self.hub.grip).is_some_and(|grip| grip.viewer == self.id)
    }

    /// Passes a request on. False if too many wait already: it is dropped.
    pub fn ask(&mut self, request: Request) -> bool {
        match request {
            Request::Drive { steer, throttle, brake, reverse, analog } => {
                if let Some(grip) = lock(&self.hub.grip).as_mut().filter(|grip| grip.viewer == self.id) {
                    grip.wanted = Wanted { steer, throttle, brake, reverse, analog };
                    grip.told = Instant::now();
                }
                true
            }
            Request::Look { chase, stages } => {
                self.look_at((chase, stages));
                self.ask(Request::Refresh)
            }
            request => self.hub.requests.try_send((self.id, request)).is_ok(),
        }
    }

    fn look_at(&mut self, look: (bool, bool)) {
        let count = |counter: &AtomicUsize, before: bool, now: bool| match (before, now) {
            (false, true) => _ = counter.fetch_add(1, Ordering::Relaxed),
            (true, false) => _ = counter.fetch_sub(1, Ordering::Relaxed),
            _ => {}
        };
        count(&self.hub.chase, self.look.0, look.0);
        count(&self.hub.stages, self.look.1, look.1);
        self.look = look;
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.look_at((false, false));
        self.hub.viewers.fetch_sub(1, Ordering::Relaxed);
        // One that drove: its silence is found out with the next tick.
        if let Some(grip) = lock(&self.hub.grip).as_mut().filter(|grip| grip.viewer == self.id) {
            let now = Instant::now();
            grip.seen = now.checked_sub(2 * GRIP).unwrap_or(now);
            grip.wanted = Wanted::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_viewer_at_a_time_holds_the_wheel_and_loses_it_when_it_goes() {
        let (hub, _requests) = Hub::new();
        let (mut one, two) = (Viewer::join(&hub), Viewer::join(&hub));
        assert!(hub.take_wheel(one.id) && !hub.take_wheel(two.id));
        assert!(one.ask(Request::Drive {
            steer: 0.5,
            throttle: 1.0,
            brake: 0.0,
            reverse: false,
            analog: false
        }));
        assert!(matches!(hub.hands(), Hands::On(id, wanted) if id == one.id && wanted.steer == 0.5));
        one.is_there();
        let id = one.id;
        assert!(one.drives() && !two.drives());
        drop(one);
        assert_eq!(hub.hands(), Hands::Lost(id));
        assert_eq!(hub.hands(), Hands::Off);
        assert!(hub.take_wheel(two.id));
        assert_eq!(hub.viewers(), 1);
    }

    #[test]
    fn requests_beyond_what_a_run_can_take_are_dropped() {
        let (hub, requests) = Hub::new();
        let mut viewer = Viewer::join(&hub);
        let taken = (0..2 * WAITING).filter(|_| viewer.ask(Request::Step {})).count();
        assert_eq!(taken, WAITING);
        drop(requests);
    }
}
