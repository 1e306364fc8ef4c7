//! A run with viewers: its pace, what is shown of it, and viewers' requests between ticks.

mod drivers;

use super::artist::Artist;
use super::hub::{Hands, Hub, Shot};
use super::net;
use super::protocol::{EgoNow, Note, Noted, Request, State};
use super::score::{Score, Tick};
use super::server::{Listener, ViewError};
use super::wheel::Wheel;
use crate::bridge::Ego;
use crate::camera::Preset;
use crate::cores::Cores;
use crate::drive::{Drive, DriveError, Status};
use crate::driver::Pilot;
use crate::network::Route;
use crate::telemetry::Wish;
use crate::traffic::Counts;
use crate::vehicle::Control;
use serde_json::json;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::{mpsc, oneshot};

/// Makes the driver of a name; called on a thread of its own.
pub type MakeDriver = Arc<dyn Fn(&str) -> Result<Pilot, String> + Send + Sync>;

/// The autopilot's and the person's names among the drivers.
const AUTOPILOT: &str = "autopilot";
const MANUAL: &str = "manual";
/// A viewer's ego this far off the route (m) gets a new route. Tried every so many ticks.
const ASTRAY: f64 = 6.0;
const ASTRAY_TICKS: u64 = 12;
/// Notes that are sent with every tick, so that none is lost when a tick is left out.
const NOTES: usize = 40;
/// A tick that is late by more than this is not caught up with.
const SLACK: Duration = Duration::from_millis(250);

/// The settings of a run with viewers.
pub struct RunSetting {
    /// The run's seed.
    pub seed: u64,
    /// The driver: `autopilot`, or an agent's name.
    pub driver: String,
    /// The weather at the start.
    pub weather: Preset,
    /// Speed, times real time; 0: as fast as possible.
    pub speed_factor: f64,
    /// Names of the agents to pick from.
    pub agents: Vec<String>,
    /// Makes drivers that viewers choose; None: none can be chosen.
    pub make_driver: Option<MakeDriver>,
    /// Background traffic that is kept alive; None: the config's own.
    pub traffic: Option<Counts>,
    /// The film that runs already.
    pub recording: Option<String>,
    /// The run's folder, as shown to viewers.
    pub folder: String,
}

/// The next thing to do.
#[derive(Debug)]
pub enum Ready {
    /// The tick is due; with the control of a viewer who drives.
    Tick(Option<Control>),
    /// Begin or end a film; [`RunView::filming`] gets the result.
    Film(bool),
}

type Loading = (String, oneshot::Receiver<Result<Pilot, String>>);

/// See the module.
pub struct RunView {
    hub: Arc<Hub>,
    requests: mpsc::Receiver<(u64, Request)>,
    threads: Vec<JoinHandle<()>>,
    cores: Option<Cores>,
    setting: RunSetting,
    state: State,
    score: Score,
    notes: VecDeque<Noted>,
    noted: u64,
    route: Option<Arc<Route>>,
    /// The viewer's controls, while a viewer drives.
    wheel: Option<Wheel>,
    astray_until: u64,
    loading: Option<Loading>,
    /// The drivers of the egos that were followed before, by number.
    drivers: BTreeMap<usize, String>,
    /// A trained agent that does not drive at present.
    parked: Option<(String, Pilot)>,
    due: Instant,
    step: bool,
    ticked: VecDeque<Instant>,
    /// A film is to begin or to end.
    film: Option<bool>,
}

impl RunView {
    /// Opens the page for a run.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub fn open(
        mut listener: Listener,
        drive: &Drive,
        artist: Artist,
        setting: RunSetting,
    ) -> Result<Self, ViewError> {
        let (hub, requests) = Hub::new();
        let cores = listener.cores();
        let bridge = drive.bridge();
        hub.set_map(net::street_map(bridge.network(), drive.assets().polygons()));
        let (stages, reconstruction) = artist.stages();
        hub.set_hello(json!({
            "mode": "run",
            "town": bridge.config().name(),
            "seed": setting.seed,
            "folder": setting.folder,
            "agents": setting.agents,
            "weathers": Preset::ALL.map(Preset::name),
            "stages": stages,
            "reconstruction": reconstruction,
            "version": env!("WAD_COSIM_VERSION"),
        }));
        let drawing = {
            let hub = Arc::clone(&hub);
            let work = move || {
                if let Some(cores) = cores {
                    cores.confine(0);
                }
                artist.work(&hub, 0);
            };
            std::thread::Builder::new()
                .name("view artist".to_string())
                .spawn(work)
                .map_err(ViewError::Thread)?
        };
        let serving = listener.serve(Arc::clone(&hub))?;
        let state = State {
            dt: bridge.tick(),
            speed_factor: setting.speed_factor,
            driver: setting.driver.clone(),
            weather: setting.weather.name().to_string(),
            wanted_traffic: setting.traffic.map(|c| (c.vehicles, c.pedestrians)),
            recording: setting.recording.clone(),
            ..State::default()
        };
        let mut view = Self {
            hub,
            requests,
            threads: vec![drawing, serving],
            cores,
            setting,
            state,
            score: Score::default(),
            notes: VecDeque::new(),
            noted: 0,
            route: None,
            wheel: None,
            astray_until: 0,
            loading: None,
            drivers: BTreeMap::new(),
            parked: None,
            due: Instant::now(),
            step: false,
            ticked: VecDeque::new(),
            film: None,
        };
        view.show_ego(drive);
        Ok(view)
    }

    /// Waits until there is something to do, and handles viewers' requests meanwhile.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn next(&mut self, drive: &mut Drive) -> Result<Ready, DriveError> {
        loop {
            while let Ok((viewer, request)) = self.requests.try_recv() {
                self.grant(viewer, request, drive).await?;
            }
            self.take_loaded(drive);
            if let Some(on) = self.film.take() {
                return Ok(Ready::Film(on));
            }
            let runs = !self.state.paused || self.step;
            if runs && Instant::now() >= self.due {
                self.step = false;
                let control = self.control(drive).await?;
                self.due = self.next_due();
                return Ok(Ready::Tick(control));
            }
            let due = self.due;
            let loaded = async {
                match &mut self.loading {
                    Some((_, loaded)) => Some(loaded.await),
                    None => std::future::pending().await,
                }
            };
            let request = tokio::select! {
                request = self.requests.recv() => request,
                () = tokio::time::sleep_until(due.into()), if runs => None,
                Some(loaded) = loaded => {
                    self.loaded(loaded.unwrap_or_else(|_| Err("it could not be loaded".to_string())), drive);
                    None
                }
            };
            if let Some((viewer, request)) = request {
                self.grant(viewer, request, drive).await?;
            }
        }
    }

    fn next_due(&self) -> Instant {
        let now = Instant::now();
        if self.state.speed_factor <= 0.0 {
            return now;
        }
        let next = self.due + Duration::from_secs_f64(self.state.dt / self.state.speed_factor);
        if next + SLACK < now { now } else { next }
    }

    /// The control of the viewer who drives, if there is one.
    async fn control(&mut self, drive: &mut Drive) -> Result<Option<Control>, DriveError> {
        match self.hub.hands() {
            Hands::On(_, wanted) => {
                let Some(wheel) = &mut self.wheel else { return Ok(None) };
                let at = drive.ego().on_route();
                let control = wheel.follow(&wanted, at.state.speed, self.state.dt);
                if at.d.abs() > ASTRAY && self.state.tick >= self.astray_until {
                    self.astray_until = self.state.tick + ASTRAY_TICKS;
                    drive.grant(Wish::FindBack).await?;
                }
                Ok(Some(control))
            }
            Hands::Lost(viewer) => {
                tracing::warn!("viewer {viewer} has gone while driving: the autopilot takes over");
                self.say(format!("viewer {viewer} has gone while driving: the autopilot takes over"));
                self.give_back(drive).await?;
                Ok(None)
            }
            Hands::Off => Ok(None),
        }
    }

    /// Shows a tick.
    pub fn show(&mut self, drive: &Drive, status: &Status) {
        let record = &status.record;
        self.score.count(&Tick::of(drive, status));
        for event in &record.events {
            self.note(record.time, Note::Event(event.clone()));
        }
        let state = &mut self.state;
        state.tick = record.tick;
        state.time = record.time;
        state.control = record.control;
        state.limit = record.limit;
        state.light = record.light;
        state.leader = record.leader;
        state.option = Some(record.route.option);
        state.lane.clone_from(&record.route.lane);
        state.traffic = (record.vehicles, record.pedestrians);
        let reason = record.reason.and_then(|r| serde_json::to_value(r).ok());
        state.reason = reason.and_then(|r| Some(r.get("kind")?.as_str()?.replace('_', " ")));
        state.reward = self.score.terms.values();
        state.sums = self.score.sums.values();
        let now = Instant::now();
        self.ticked.push_back(now);
        if self.ticked.len() > 12 {
            self.ticked.pop_front();
        }
        if let (Some(first), true) = (self.ticked.front(), self.ticked.len() > 1) {
            let passed = (now - *first).as_secs_f64().max(1e-6);
            state.pace = (self.ticked.len() - 1) as f64 * state.dt / passed;
        }
        let [a, b, c, d, e, f] = state.reward.map(|v| v as f32);
        let speed = record.ego.speed as f32;
        self.hub.remember([state.time as f32, speed, state.limit as f32, a, b, c, d, e, f]);
        self.show_ego(drive);
    }

    /// Shows the ego's new place, with the rest of the state unchanged.
    fn show_ego(&mut self, drive: &Drive) {
        let (ego, bridge) = (drive.ego(), drive.bridge());
        let at = ego.on_route();
        let to = drive.destination_s();
        let route = self.follow_route(ego, to);
        let state = &mut self.state;
        state.ego = ego_now(ego);
        state.followed = drive.followed();
        state.egos.clear();
        if drive.egos().nth(1).is_some() {
            state.egos.extend(drive.egos().map(|ego| {
                let now = ego_now(ego);
                [now.x, now.y, now.heading, now.speed, now.length, now.width]
            }));
        }
        state.route = (at.s, at.d, to);
        state.seq += 1;
        state.viewers = self.hub.viewers();
        state.at = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64() * 1000.0);
        state.time = bridge.time();
        if state.viewers == 0 {
            return;
        }
        state.notes = self.notes.iter().cloned().collect();
        self.hub.show(Shot {
            state: state.clone(),
            world: ego.world().clone(),
            ego: ego.as_actor(),
            weather: self.setting.weather,
            look: drive.last_look(),
            way: Some((route, at)),
        });
    }

    /// The ego's route. If it or its destination, at `to` (m), has changed, viewers get its line up to there.
    fn follow_route(&mut self, ego: &Ego, to: f64) -> Arc<Route> {
        let now = ego.route();
        let same = |old: &Arc<Route>| {
            (old.from, old.to, old.sections.len()) == (now.from, now.to, now.sections.len())
                && old.length() == now.length()
        };
        let known = self.route.as_ref().filter(|_| self.state.route.2 == to);
        if let Some(old) = known.filter(|old| same(old)) {
            return Arc::clone(old);
        }
        let route = Arc::new(now.clone());
        self.state.route_id += 1;
        let id = self.state.route_id;
        let text =
            json!({ "type": "route", "id": id, "line": net::line(&route.centre_line, to, 3.0) }).to_string();
        self.hub.set_route(id, text);
        self.route = Some(Arc::clone(&route));
        route
    }

    fn note(&mut self, time: f64, what: Note) {
        self.noted += 1;
        self.notes.push_back(Noted { n: self.noted, time, what });
        if self.notes.len() > NOTES {
            self.notes.pop_front();
        }
    }

    fn say(&mut self, said: String) {
        self.note(self.state.time, Note::Said { said });
    }

    async fn grant(&mut self, viewer: u64, request: Request, drive: &mut Drive) -> Result<(), DriveError> {
        match request {
            Request::Pause { on } => {
                self.state.paused = on;
                self.due = Instant::now();
            }
            Request::Step {} => {
                self.state.paused = true;
                self.step = true;
                self.due = Instant::now();
            }
            Request::Speed { factor } => {
                self.state.speed_factor = factor;
                self.due = Instant::now();
                self.ticked.clear();
            }
            Request::Respawn {} => {
                drive.grant(Wish::Respawn).await?;
                self.score.reset();
                self.hub.forget_history();
                self.say("moved to another place; the sums start again".to_string());
            }
            Request::NewRoute {} => {
                let text = if drive.grant(Wish::NewRoute).await? {
                    "a new destination"
                } else {
                    "no way leads on from here; try respawn"
                };
                self.say(text.to_string());
            }
            Request::Weather { name } => {
                self.setting.weather = name;
                self.state.weather = name.name().to_string();
                drive.set_weather(name);
            }
            Request::Traffic { vehicles, pedestrians } => {
                drive.grant(Wish::Traffic { vehicles, pedestrians }).await?;
                self.state.wanted_traffic = Some((vehicles, pedestrians));
            }
            Request::Record { on } => self.film = Some(on),
            Request::Driver { name } if self.denies(viewer, &name) => {}
            Request::Driver { name } if name == MANUAL => self.take_over(viewer, drive),
            Request::Driver { name } if name == AUTOPILOT => {
                self.stop_loading();
                self.give_back(drive).await?;
            }
            Request::Driver { name } => self.load(name, drive).await?,
            Request::Follow { ego } => self.follow(ego, viewer, drive).await?,
            Request::Refresh => {}
            Request::Seek { .. } | Request::Open { .. } => self.say("not a replay".to_string()),
            Request::Drive { .. } | Request::Look { .. } | Request::Shown { .. } => return Ok(()),
        }
        self.show_ego(drive);
        Ok(())
    }

    /// The result of [`Ready::Film`]: the film that is running, or why there is none.
    pub fn filming(&mut self, film: Result<Option<&Path>, String>, drive: &Drive) {
        match film {
            Ok(film) => {
                let name = film.map(|path| path.display().to_string());
                match (&name, self.state.recording.take()) {
                    (Some(name), _) => self.say(format!("filming to {name}")),
                    (None, Some(was)) => self.say(format!("the film is in {was}")),
                    (None, None) => {}
                }
                self.state.recording = name;
            }
            Err(why) => {
                self.state.recording = None;
                self.say(why);
            }
        }
        self.show_ego(drive);
    }

    /// The cores for all but the simulation.
    pub fn cores(&self) -> Option<Cores> {
        self.cores
    }

    /// Tells the viewers that the run is over, and ends the threads.
    pub fn close(self) {
        self.hub.close();
        for thread in self.threads {
            if thread.join().is_err() {
                tracing::warn!("a thread of the live view has panicked");
            }
        }
    }
}

/// The ego for the page.
pub fn ego_now(ego: &Ego) -> EgoNow {
    let (state, params) = (ego.state(), ego.params());
    EgoNow {
        x: state.pose.position.x,
        y: state.pose.position.y,
        heading: state.pose.heading,
        speed: state.speed,
        acceleration: state.acceleration,
        yaw_rate: state.yaw_rate,
        steer_angle: state.steer_angle,
        length: params.length,
        width: params.width,
    }
}
