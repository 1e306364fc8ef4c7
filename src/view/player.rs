//! A recorded episode with viewers: the same page with a timeline, and a list of other episodes.

use super::artist::Artist;
use super::hub::{Hub, Shot};
use super::net;
use super::protocol::{EgoNow, Note, Noted, Request, State};
use super::score::{Score, Tick};
use super::server::{Listener, ViewError};
use crate::autopilot::{Autopilot, AutopilotParams, EgoModel};
use crate::camera::Preset;
use crate::criteria::Event;
use crate::network::{Network, Route};
use crate::replay::{Frame, Recording};
use crate::telemetry::{LeaderRecord, LightRecord};
use crate::vehicle::EgoParams;
use serde::Serialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// An episode in the list.
#[derive(Clone, Debug, Serialize)]
pub struct Listed {
    /// Its id in requests.
    pub id: String,
    /// Agent, town and task.
    pub name: String,
    /// How the episode ended.
    pub outcome: String,
    /// A line that identifies it in the list.
    pub about: String,
}

/// The episode to play.
pub struct Played {
    /// The recorded states.
    pub recording: Recording,
    /// The episode in the list.
    pub listed: Listed,
    /// The town's network.
    pub network: Arc<Network>,
    /// Its route, if it can still be made: for perception and speed limits.
    pub route: Option<Route>,
    /// The ego's physics.
    pub ego: EgoParams,
    /// The driver.
    pub driver: String,
    /// How it ended, in words.
    pub ending: String,
    /// Buildings and the like for the map.
    pub map: String,
    /// Draws the town.
    pub artist: Artist,
}

/// The next thing to do.
#[derive(Debug)]
pub enum Next {
    /// A viewer opens another episode, by its id.
    Open(String),
}

/// Plays an episode to the page's viewers.
pub struct Player {
    hub: Arc<Hub>,
    requests: mpsc::Receiver<(u64, Request)>,
    server: Option<JoinHandle<()>>,
    drawing: Option<JoinHandle<()>>,
    played: Box<Show>,
    episodes: Vec<Listed>,
    at: usize,
    state: State,
    weather: Preset,
    due: Instant,
    notes: Vec<(usize, Noted)>,
}

/// The parts of an episode that are shown.
struct Show {
    recording: Recording,
    route: Option<Arc<Route>>,
    course: Vec<Seen>,
    driver: String,
    ending: String,
}

/// What the recording does not hold: the reward's terms and their sums, and what is ahead.
#[derive(Clone, Copy)]
struct Seen {
    terms: [f64; 6],
    sums: [f64; 6],
    light: Option<LightRecord>,
    leader: Option<LeaderRecord>,
}

/// Runs the autopilot over an episode's recorded states.
fn course(recording: &Recording, network: &Network, route: &Route, ego: &EgoParams) -> Vec<Seen> {
    let mut autopilot = Autopilot::new(AutopilotParams::default(), EgoModel::from(ego));
    let mut score = Score::default();
    let dt = recording.header().tick_ms / 1000.0;
    let seen = |frame: &Frame| {
        let decision = autopilot.control(network, route, frame.s, &frame.ego, &frame.world, dt);
        autopilot.overruled();
        let leader = decision.leader.map(|l| LeaderRecord { gap: l.gap_m, speed: l.speed_mps });
        let light = score.count(&Tick {
            network,
            route,
            at: frame.on_route(ego.length),
            ego,
            signals: &frame.world.traffic_lights,
            dt,
            control: frame.control,
            leader,
            events: &frame.events,
        });
        let light = light.map(|l| LightRecord { state: l.state, distance: l.distance });
        Seen { terms: score.terms.values(), sums: score.sums.values(), light, leader }
    };
    recording.frames().iter().map(seen).collect()
}

impl Show {
    fn of(
        recording: Recording,
        route: Option<Route>,
        network: &Network,
        ego: &EgoParams,
        who: (String, String),
    ) -> Self {
        let course = route.as_ref().map(|route| course(&recording, network, route, ego)).unwrap_or_default();
        Self { recording, route: route.map(Arc::new), course, driver: who.0, ending: who.1 }
    }
}

impl Player {
    /// Opens the page for an episode, played at `speed_factor` times real time; `episodes` are those to
    /// pick from.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub fn open(
        listener: Listener,
        played: Played,
        episodes: Vec<Listed>,
        speed_factor: f64,
    ) -> Result<Self, ViewError> {
        let (hub, requests) = Hub::new();
        let Played { recording, listed, network, route, ego, driver, ending, map, artist } = played;
        let show = Show::of(recording, route, &network, &ego, (driver, ending));
        let mut player = Self {
            hub: Arc::clone(&hub),
            requests,
            server: None,
            drawing: None,
            played: Box::new(show),
            episodes,
            at: 0,
            state: State { speed_factor, ..State::default() },
            weather: Preset::ClearNoon,
            due: Instant::now(),
            notes: Vec::new(),
        };
        player.begin(&listed, &map, artist)?;
        player.server = Some(listener.serve(hub)?);
        Ok(player)
    }

    /// Plays another episode.
    ///
    /// # Errors
    /// The artist's thread cannot be started.
    pub fn change(&mut self, played: Played) -> Result<(), ViewError> {
        let Played { recording, listed, network, route, ego, driver, ending, map, artist } = played;
        *self.played = Show::of(recording, route, &network, &ego, (driver, ending));
        self.begin(&listed, &map, artist)
    }

    fn begin(&mut self, listed: &Listed, map: &str, artist: Artist) -> Result<(), ViewError> {
        let header = self.played.recording.header();
        let frames = self.played.recording.frames();
        self.weather = header.weather;
        let (stages, reconstruction) = artist.stages();
        self.hub.set_map(map.to_string());
        self.notes = notes(frames);
        let marks: Vec<Value> = (frames.iter().enumerate())
            .flat_map(|(i, frame)| frame.events.iter().map(move |event| json!([i, kind(event)])))
            .collect();
        let point = |(frame, seen): (&Frame, &Seen)| {
            let [a, b, c, d, e, f] = seen.terms;
            [frame.world.time, frame.ego.speed, 0.0, a, b, c, d, e, f].map(|v| v as f32)
        };
        let points: Vec<[f32; 9]> = frames.iter().zip(&self.played.course).map(point).collect();
        self.hub.set_hello(json!({
            "mode": "replay",
            "town": header.town,
            "folder": listed.id,
            "episode": listed.id,
            "episodes": self.episodes,
            "ticks": frames.len(),
            "marks": marks,
            "course": points,
            "agents": [],
            "weathers": Preset::ALL.map(Preset::name),
            "stages": stages,
            "reconstruction": reconstruction,
            "version": env!("WAD_COSIM_VERSION"),
        }));
        self.state.dt = header.tick_ms / 1000.0;
        self.state.route_id += 1;
        let id = self.state.route_id;
        let line = match &self.played.route {
            Some(route) => net::line(&route.centre_line, route.length(), 3.0),
            None => header.route.iter().flatten().map(|v| Value::from(net::tenth(*v))).collect(),
        };
        self.hub.set_route(id, json!({ "type": "route", "id": id, "line": line }).to_string());
        (self.at, self.state.paused, self.state.over, self.due) = (0, false, None, Instant::now());
        let number = self.hub.another_artist();
        if let Some(drawing) = self.drawing.take()
            && drawing.join().is_err()
        {
            tracing::warn!("the thread that draws has panicked");
        }
        let hub = Arc::clone(&self.hub);
        let thread = std::thread::Builder::new().name("view artist".to_string());
        self.drawing = Some(thread.spawn(move || artist.work(&hub, number)).map_err(ViewError::Thread)?);
        // Pages that show another episode reload and get this one.
        self.hub.greet_again();
        self.show();
        Ok(())
    }

    /// Plays until a viewer opens another episode.
    pub async fn next(&mut self) -> Next {
        loop {
            let runs = !self.state.paused && self.at + 1 < self.played.recording.frames().len();
            let due = self.due;
            let request = tokio::select! {
                request = self.requests.recv() => request,
                () = tokio::time::sleep_until(due.into()), if runs => None,
            };
            match request {
                Some((_, Request::Open { episode })) => return Next::Open(episode),
                Some((_, request)) => self.grant(request),
                None => {
                    self.at += 1;
                    // At the end it waits to be played again.
                    self.state.paused = self.at + 1 == self.played.recording.frames().len();
                    let factor = if self.state.speed_factor > 0.0 { self.state.speed_factor } else { 50.0 };
                    self.due =
                        (self.due + Duration::from_secs_f64(self.state.dt / factor)).max(Instant::now());
                    self.show();
                }
            }
        }
    }

    fn grant(&mut self, request: Request) {
        let last = self.played.recording.frames().len().saturating_sub(1);
        match request {
            Request::Seek { tick } => self.at = tick.min(last),
            Request::Pause { on } => {
                // From the end it begins again.
                if !on && self.at == last {
                    self.at = 0;
                }
                self.state.paused = on;
            }
            Request::Step {} => {
                self.state.paused = true;
                self.at = (self.at + 1).min(last);
            }
            Request::Speed { factor } => self.state.speed_factor = factor,
            Request::Weather { name } => self.weather = name,
            Request::Refresh => {}
            _ => return,
        }
        self.due = Instant::now() + Duration::from_secs_f64(self.state.dt);
        self.show();
    }

    /// Tells the viewers why an episode cannot be shown.
    pub fn say(&self, why: String) {
        self.hub.refusal.send_replace(why);
    }

    fn show(&mut self) {
        let recording = &self.played.recording;
        let frames = recording.frames();
        let Some(frame) = frames.get(self.at) else { return };
        let body = recording.header().ego;
        let state = &mut self.state;
        state.seq += 1;
        state.tick = self.at as u64;
        state.time = frame.world.time;
        state.at = 0.0;
        state.pace = state.speed_factor;
        state.driver.clone_from(&self.played.driver);
        state.weather = self.weather.name().to_string();
        state.traffic = (frame.world.vehicles.len(), frame.world.pedestrians.len());
        state.control = frame.control;
        let pose = frame.ego.pose;
        state.ego = EgoNow {
            x: pose.position.x,
            y: pose.position.y,
            heading: pose.heading,
            speed: frame.ego.speed,
            acceleration: frame.ego.acceleration,
            yaw_rate: frame.ego.yaw_rate,
            steer_angle: frame.ego.steer_angle,
            length: body.length,
            width: body.width,
        };
        let route = self.played.route.as_ref();
        let here = route.map(|route| route.at(frame.s));
        state.limit = here.map_or(0.0, |here| here.speed_limit);
        state.option = here.map(|here| here.option);
        state.route = (frame.s, frame.d, route.map_or(0.0, |route| route.length()));
        if let Some(seen) = self.played.course.get(self.at) {
            (state.reward, state.sums) = (seen.terms, seen.sums);
            (state.light, state.leader) = (seen.light, seen.leader);
        }
        let ended = self.at + 1 == frames.len();
        state.over = ended.then(|| self.played.ending.clone());
        state.viewers = self.hub.viewers();
        state.notes =
            self.notes.iter().filter(|(at, _)| *at <= self.at).map(|(_, note)| note.clone()).collect();
        if state.viewers == 0 {
            return;
        }
        let way = route.map(|route| (Arc::clone(route), frame.on_route(body.length)));
        self.hub.show(Shot {
            state: state.clone(),
            world: frame.world.clone(),
            ego: recording.ego_actor(frame),
            weather: self.weather,
            look: None,
            way,
        });
    }

    /// Ends the threads.
    pub fn close(self) {
        self.hub.close();
        for thread in self.drawing.into_iter().chain(self.server) {
            if thread.join().is_err() {
                tracing::warn!("a thread of the live view has panicked");
            }
        }
    }
}

/// The events of an episode with the frames at which they happened.
fn notes(frames: &[Frame]) -> Vec<(usize, Noted)> {
    let mut n = 0;
    let events =
        frames.iter().enumerate().flat_map(|(i, f)| f.events.iter().map(move |e| (i, f.world.time, e)));
    events
        .map(|(i, time, event)| {
            n += 1;
            (i, Noted { n, time, what: Note::Event(event.clone()) })
        })
        .collect()
}

/// The event's name.
fn kind(event: &Event) -> String {
    let value = serde_json::to_value(event).unwrap_or_default();
    value.get("event").and_then(Value::as_str).unwrap_or_default().to_string()
}
