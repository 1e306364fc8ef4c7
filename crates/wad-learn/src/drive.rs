//! `run`: the autopilot or a trained agent drives an ego, or many, from destination to destination.

mod finish;
mod options;
mod summary;

pub use options::{DriveError, DriveOptions};
pub use summary::{CollisionCounts, EgoSummary, Summary};

use crate::driver::{Driver, Pilot};
use crate::env::ego_id;
use nalgebra::Point2;
use options::RunConfig;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use summary::Totals;
use sumo_network::network::{LanePosition, Network};
use sumo_network::seeds;
use wad_camera::{Preset, Weather};
use wad_see::eyes::{Eyes, EyesError, Look};
use wad_see::perception::EgoFacts;
use wad_sim::assets::Assets;
use wad_sim::autopilot::Decision;
use wad_sim::bridge::{Bridge, BridgeError, Ego};
use wad_sim::cores;
use wad_sim::criteria::Event;
use wad_sim::destination::{self, DestinationError};
use wad_sim::end::{self, Ending, Termination};
use wad_sim::scenario::Scenario;
use wad_sim::session::{APART, Act, Itinerary, Seat, Session};
use wad_sim::telemetry::{LeaderRecord, LightRecord, RouteRecord, RunFolder, TickRecord, Wish};
use wad_sim::traffic::Counts;
use wad_vehicle::Control;

/// The facts of the status line.
#[derive(Clone, Debug)]
pub struct Status {
    /// The tick's telemetry of the ego that is followed.
    pub record: TickRecord,
    /// Ticks per second of wall time, lately.
    pub ticks_per_second: f64,
}

/// An ego of a drive with its driver.
struct Car {
    pilot: Pilot,
    /// Its driver's seed.
    seed: u64,
    itinerary: Itinerary,
    totals: Totals,
    /// The viewer or agent that replaced the run's own driver.
    guest: Option<String>,
    /// Requests since the last tick.
    wishes: Vec<Wish>,
    /// Whether its eyes have processed the current tick.
    looked: bool,
}

/// A running drive: a session whose egos go from destination to destination. One of them is *followed*: films, the live
/// view and requests are about it.
pub struct Drive {
    session: Session,
    cars: Vec<Car>,
    followed: usize,
    /// Camera and perception for film and live view, if the driver of the followed ego has none.
    spare: Eyes,
    folder: RunFolder,
    options: DriveOptions,
    scenario: Option<Arc<Scenario>>,
    weather: Weather,
    /// Wall time of the drivers, including camera and perception (s).
    piloting: f64,
    began: Instant,
    /// The scenario's time limit (ticks), and how it ended.
    limit: Option<u64>,
    ending: Option<Ending>,
}

/// Wall time of the ticks so far, by part (s).
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    /// Bridge: sending poses, SUMO's step, decoding the new world.
    pub bridge: f64,
    /// SUMO's part of it: from sending the message to the complete answer.
    pub sumo: f64,
    /// Our CPU time in it.
    pub bridge_cpu: f64,
    /// The ego's physics.
    pub physics: f64,
    /// The driver, including camera, perception and encoder.
    pub agent: f64,
}

impl Drive {
    /// Reads the town, starts SUMO, draws or reads the first route, and puts the ego on it. The autopilot
    /// drives.
    ///
    /// # Errors
    /// Bad input, SUMO fails, or the run folder cannot be written. Nothing is left running.
    pub async fn start(options: DriveOptions) -> Result<Self, DriveError> {
        let plays = options.bridge.scenario;
        let assets = Assets::open(&options.bridge.config, plays)?;
        Self::start_in(&assets, options, vec![Pilot::autopilot()], Preset::default()).await
    }

    /// The same in a loaded town in `weather`, with an ego for each of `pilots`. The autopilot then only reports what held
    /// an ego. The town's scenario is played, if it has one. `options.route` is the first ego's.
    ///
    /// # Errors
    /// As [`Drive::start`]; the town has no room for so many egos, or plays a scenario, which has one.
    ///
    /// # Panics
    /// `pilots` is empty.
    pub async fn start_in(
        assets: &Arc<Assets>,
        mut options: DriveOptions,
        mut pilots: Vec<Pilot>,
        weather: Preset,
    ) -> Result<Self, DriveError> {
        assert!(!pilots.is_empty(), "a drive has one ego or more");
        options.ego.check().map_err(BridgeError::from)?;
        options.egos = pilots.len();
        let scenario = assets.scenario().cloned();
        if let Some(scenario) = &scenario {
            if pilots.len() > 1 {
                return Err(DriveError::Scenario { egos: pilots.len() });
            }
            options.bridge.scenario = true;
            options.bridge.closed_lanes.clone_from(&scenario.closed_lanes);
        }
        let network = assets.network();
        network.require_drivable(destination::EGO_CLASS).map_err(BridgeError::from)?;
        let seed = |index: usize| match index {
            0 => options.bridge.seed,
            _ => seeds::derive(options.bridge.seed, &ego_id(index)),
        };
        for (index, pilot) in pilots.iter_mut().enumerate() {
            pilot.reset(weather, seed(index));
        }
        let record = (!pilots[EGO].driver.is_autopilot()).then_some(&pilots[EGO].record);
        let folder = RunFolder::create(&options.out, &RunConfig { options: &options, driver: record })?;
        let (mut cars, mut seats) = (Vec::with_capacity(pilots.len()), Vec::with_capacity(pilots.len()));
        let mut starts: Vec<Point2<f64>> = Vec::with_capacity(pilots.len());
        for (index, pilot) in pilots.into_iter().enumerate() {
            let mut itinerary = Itinerary::new(network, seeds::rng(seed(index), "route"))?;
            let route = match (&options.route, &scenario) {
                (None, Some(scenario)) => scenario.route.clone(),
                (Some(text), _) if index == EGO => {
                    let (from, to) = destination::parse_route(network, text)?;
                    network.route(from, to, destination::EGO_CLASS).map_err(DestinationError::from)?
                }
                _ => match itinerary.route_apart(network, &starts, APART)? {
                    Some(route) => route,
                    None => {
                        let town = options.bridge.config.display().to_string();
                        return Err(DriveError::Crowded { town, fit: index, egos: options.egos });
                    }
                },
            };
            starts.push(route.at(0.0).pose.xy());
            let (ego, autopilot, criteria) = (options.ego.clone(), options.autopilot, options.criteria);
            seats.push(Seat::new(assets, &ego_id(index), ego, autopilot, criteria, route));
            cars.push(Car {
                pilot,
                seed: seed(index),
                itinerary,
                totals: Totals::default(),
                guest: None,
                wishes: Vec::new(),
                looked: false,
            });
        }
        let session = Session::start(assets, &options.bridge, seats).await?;
        let limit = scenario.as_ref().map(|scenario| scenario.tick_limit(session.bridge().tick()));
        Ok(Self {
            session,
            cars,
            followed: EGO,
            spare: Eyes::blind(),
            folder,
            options,
            scenario,
            weather: weather.into(),
            piloting: 0.0,
            began: Instant::now(),
            limit,
            ending: None,
        })
    }

    /// The co-simulation.
    pub fn bridge(&self) -> &Bridge {
        self.session.bridge()
    }

    /// The same, for requests to SUMO beside the drive.
    pub fn bridge_mut(&mut self) -> &mut Bridge {
        self.session.bridge_mut()
    }

    /// The town.
    pub fn assets(&self) -> &Arc<Assets> {
        self.session.assets()
    }

    /// The ego that is followed.
    pub fn ego(&self) -> &Ego {
        self.session.ego(self.followed)
    }

    /// Where its destination lies on its route (m): the route may lead on behind it.
    pub fn destination_s(&self) -> f64 {
        self.session.seats()[self.followed].destination_s()
    }

    /// All egos.
    pub fn egos(&self) -> impl Iterator<Item = &Ego> {
        self.session.seats().iter().map(Seat::ego)
    }

    /// The number of the ego that is followed, among [`Drive::egos`].
    pub fn followed(&self) -> usize {
        self.followed
    }

    /// Follows another ego from now on; false if there is none of that number.
    pub fn follow(&mut self, index: usize) -> bool {
        if index >= self.cars.len() {
            return false;
        }
        self.followed = index;
        self.spare.reset(self.weather.clone(), self.cars[index].seed);
        let blind = !self.cars[index].pilot.driver.looks();
        self.cars[index].looked &= !blind;
        true
    }

    fn car(&self) -> &Car {
        &self.cars[self.followed]
    }

    /// Times that the followed ego was moved to another place.
    pub fn respawns(&self) -> u64 {
        self.car().totals.respawns
    }

    /// How the scenario ended; None without a scenario or before its end.
    pub fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// Wall time by part.
    pub fn timings(&self) -> Timings {
        let times = self.session.timings();
        Timings {
            bridge: times.bridge,
            sumo: times.sumo,
            bridge_cpu: times.bridge_cpu,
            physics: times.physics,
            agent: times.expert + self.piloting,
        }
    }

    /// Saves SUMO's state, persons and random generators included.
    ///
    /// # Errors
    /// SUMO fails or cannot write the file.
    pub async fn save_state(&mut self, file: &Path) -> Result<(), DriveError> {
        Ok(self.bridge_mut().save_state(file).await?)
    }

    /// The eyes of the followed ego's driver after this tick; if it has none, the eyes of [`Drive::watch_with`]. Renders
    /// once a tick, however often it is called.
    ///
    /// # Errors
    /// A stage of perception fails.
    pub fn look(&mut self) -> Result<&Eyes, DriveError> {
        let (ego, bridge) = (self.session.ego(self.followed), self.session.bridge());
        let car = &mut self.cars[self.followed];
        let eyes = if car.pilot.driver.looks() { &mut car.pilot.eyes } else { &mut self.spare };
        if !car.looked {
            look(eyes, ego, bridge.network(), bridge.tick())?;
            car.looked = true;
        }
        Ok(eyes)
    }

    /// The eyes of the followed ego as of their last frame.
    pub fn eyes(&self) -> &Eyes {
        let pilot = &self.car().pilot;
        if pilot.driver.looks() { &pilot.eyes } else { &self.spare }
    }

    /// The last frame and percept of the followed ego's driver; None if it is blind.
    pub fn last_look(&self) -> Option<Look> {
        let pilot = &self.car().pilot;
        if pilot.driver.looks() { pilot.eyes.last_look() } else { None }
    }

    /// Sets camera and perception for the live view while a blind driver drives (autopilot, manual, constant,
    /// random).
    pub fn watch_with(&mut self, mut eyes: Eyes) {
        eyes.reset(self.weather.clone(), self.car().seed);
        self.spare = eyes;
    }

    /// One tick: decide, move, step, judge, record.
    ///
    /// # Errors
    /// SUMO fails, or telemetry cannot be written.
    pub async fn tick(&mut self) -> Result<Status, DriveError> {
        self.tick_with(None).await
    }

    /// The same with a given control for the followed ego in place of its driver's: a viewer's, or a recorded one.
    ///
    /// # Errors
    /// As [`Drive::tick`].
    pub async fn tick_with(&mut self, given: Option<Control>) -> Result<Status, DriveError> {
        // Every tick records what held an ego, for any driver.
        let decisions: Vec<Decision> = (0..self.cars.len()).map(|i| self.session.plan(i)).collect();
        let clock = Instant::now();
        let acts = self.acts(given, &decisions)?;
        self.piloting += clock.elapsed().as_secs_f64();
        let tick = self.session.bridge().tick();
        let done = self.session.step(&acts).await?;
        let (counts, network) = (self.session.bridge().counts(), self.session.network().clone());
        let mut shown = None;
        for (index, (decision, done)) in decisions.iter().zip(done).enumerate() {
            let car = &mut self.cars[index];
            car.looked = false;
            car.totals.add(decision, &done.before.state, &done.after.state, tick, counts);
            car.totals.judge(&done.events);
            let outside = self.session.seats()[index].criteria().is_outside_lane();
            car.totals.outside_ticks += u64::from(outside);
            let record = self.record(index, &network, decision, done.control, done.events);
            self.folder.record(&record)?;
            match self.scenario.clone() {
                Some(scenario) => self.judge(&scenario, &network, &record.events),
                None => self.go_on(index, &record.events).await?,
            }
            if index == self.followed {
                shown = Some(record);
            }
        }
        let elapsed = self.began.elapsed().as_secs_f64().max(1e-9);
        let ticks_per_second = self.ticks() as f64 / elapsed;
        let record = shown.expect("the followed ego is one of those that were driven");
        Ok(Status { record, ticks_per_second })
    }

    /// What each ego does: its driver's act, or `given` for the followed one.
    fn acts(&mut self, given: Option<Control>, decisions: &[Decision]) -> Result<Vec<Act>, DriveError> {
        let (followed, network, tick) = (self.followed, self.session.network(), self.session.bridge().tick());
        let given = |index: usize| given.filter(|_| index == followed);
        let looking: Vec<(&mut Car, &Ego)> = (self.cars.iter_mut().zip(self.session.seats()).enumerate())
            .filter(|(index, (car, _))| given(*index).is_none() && car.pilot.driver.looks() && !car.looked)
            .map(|(_, (car, seat))| (car, seat.ego()))
            .collect();
        let looked = cores::each(looking, |(car, ego)| {
            car.looked = true;
            look(&mut car.pilot.eyes, ego, network, tick)
        });
        looked.into_iter().collect::<Result<(), EyesError>>()?;
        let act = |(index, car): (usize, &mut Car)| match given(index) {
            // A control read back from text may differ in its last digit from the one that was driven.
            Some(given) if is_close(&given, &decisions[index].control) => Ok(Act::Expert),
            Some(given) => Ok(Act::Control(given)),
            None => Ok(car.pilot.driver.act(&car.pilot.eyes)?),
        };
        self.cars.iter_mut().enumerate().map(act).collect()
    }

    /// Ticks so far.
    fn ticks(&self) -> u64 {
        self.cars[EGO].totals.ticks
    }

    /// Whether the scenario has ended with this tick.
    fn judge(&mut self, scenario: &Scenario, network: &Network, events: &[Event]) {
        if self.ending.is_some() {
            return;
        }
        let ticks = self.ticks();
        self.ending = match Termination::default().decide(events) {
            Some((end, cause)) => Some(end::ending(scenario.task, end, cause)),
            None if self.limit.is_some_and(|limit| ticks >= limit) => {
                Some(end::judge_limit(scenario.task, &scenario.placement, ticks, network, self.ego()))
            }
            None => None,
        };
    }

    fn record(
        &mut self,
        index: usize,
        network: &Network,
        decision: &Decision,
        control: Control,
        events: Vec<Event>,
    ) -> TickRecord {
        let car = &mut self.cars[index];
        let ego = self.session.ego(index);
        let on_route = ego.on_route();
        let at = ego.route().at(on_route.s);
        let (vehicles, pedestrians) = self.session.bridge().counts();
        TickRecord {
            tick: car.totals.ticks,
            id: (self.options.egos > 1).then(|| ego.id.to_string()),
            time: self.session.bridge().time(),
            control,
            ego: on_route.state,
            route: RouteRecord {
                lane: network.lane(at.lane).id.clone(),
                s: on_route.s,
                d: on_route.d,
                length: self.session.seats()[index].destination_s(),
                option: at.option,
            },
            limit: at.speed_limit,
            light: decision.light.map(|(state, distance)| LightRecord { state, distance }),
            leader: decision.leader.map(|leader| LeaderRecord { gap: leader.gap_m, speed: leader.speed_mps }),
            reason: car.pilot.driver.is_autopilot().then_some(decision.reason),
            events,
            vehicles,
            pedestrians,
            wishes: std::mem::take(&mut car.wishes),
            driver: car.guest.clone(),
        }
    }

    /// Draws a new destination ahead of arrival, and a new start if the ego is blocked or no way leads on.
    async fn go_on(&mut self, index: usize, events: &[Event]) -> Result<(), DriveError> {
        let itinerary = &mut self.cars[index].itinerary;
        let goes_on = if events.contains(&Event::Arrival) {
            itinerary.go_on(&mut self.session, index)
        } else {
            !events.contains(&Event::VehicleBlocked)
        };
        if !goes_on {
            self.start_elsewhere(index).await?;
        }
        self.cars[index].itinerary.plan_ahead(&mut self.session, index);
        Ok(())
    }

    async fn start_elsewhere(&mut self, index: usize) -> Result<(), DriveError> {
        let car = &mut self.cars[index];
        car.itinerary.start_elsewhere(&mut self.session, index).await?;
        car.pilot.reset(self.weather.clone(), car.seed);
        car.looked = false;
        car.totals.respawns += 1;
        if index == self.followed {
            self.spare.reset(self.weather.clone(), car.seed);
        }
        Ok(())
    }

    /// Grants a viewer's request about the followed ego before the next tick, which records it. False if it is impossible; nothing
    /// changes then.
    ///
    /// # Errors
    /// SUMO fails, or the net has nowhere to start.
    pub async fn grant(&mut self, wish: Wish) -> Result<bool, DriveError> {
        let granted = match wish {
            Wish::Respawn => {
                self.start_elsewhere(self.followed).await?;
                true
            }
            Wish::NewRoute => self.leave_for(None),
            Wish::FindBack => {
                let to = self.session.seats()[self.followed].destination();
                self.leave_for(Some(to))
            }
            Wish::Traffic { vehicles, pedestrians } => {
                self.bridge_mut().set_traffic(Counts::new(vehicles, pedestrians)).await?;
                true
            }
        };
        if granted {
            self.cars[self.followed].wishes.push(wish);
        }
        Ok(granted)
    }

    /// Routes the followed ego from its position to `to` or to a random place; false if no way leads there.
    fn leave_for(&mut self, to: Option<LanePosition>) -> bool {
        let car = &mut self.cars[self.followed];
        car.looked = false;
        car.itinerary.leave_for(&mut self.session, self.followed, to)
    }

    /// Puts another driver at the followed ego's wheel from the next tick on, and returns the one before. `guest` is what
    /// its name in telemetry, None for the run's own driver. It starts without memory, in the current
    /// weather.
    pub fn hand_over(&mut self, mut pilot: Pilot, guest: Option<String>) -> Pilot {
        let car = &mut self.cars[self.followed];
        car.guest = guest;
        pilot.reset(self.weather.clone(), car.seed);
        car.looked = false;
        std::mem::replace(&mut car.pilot, pilot)
    }

    /// The followed ego's current driver.
    pub fn driver(&self) -> &Driver {
        &self.car().pilot.driver
    }

    /// Changes the cameras' weather from the next tick on.
    pub fn set_weather(&mut self, weather: impl Into<Weather>) {
        let weather = weather.into();
        for car in &mut self.cars {
            car.pilot.eyes.set_weather(weather.clone());
            car.looked = false;
        }
        self.spare.set_weather(weather.clone());
        self.weather = weather;
    }

    /// The cameras' weather.
    pub fn weather(&self) -> Preset {
        self.weather.preset
    }
}

/// The first ego; the only one of most runs.
const EGO: usize = 0;

/// `tick` in s.
fn look(eyes: &mut Eyes, ego: &Ego, network: &Network, tick: f64) -> Result<(), EyesError> {
    eyes.follow(ego.world());
    eyes.look(&EgoFacts::of(network, ego, tick))
}

/// Equal but for the last digits that text loses.
fn is_close(a: &Control, b: &Control) -> bool {
    [(a.throttle, b.throttle), (a.steer, b.steer), (a.brake, b.brake)]
        .iter()
        .all(|(a, b)| (a - b).abs() < 1e-9)
}
