//! The one tick and the one pair of eyes, on a real SUMO: two egos in one session, a picture that does not depend on
//! what was driven before, a film that shows what the agent saw, and every driver in `run`.

use crate::program::{json, stderr, wad};
use std::path::Path;
use std::sync::Arc;
use wad_cosim::assets::Assets;
use wad_cosim::bridge::BridgeOptions;
use wad_cosim::camera::{CameraConfig, Preset};
use wad_cosim::criteria::Event;
use wad_cosim::env::{Env, EnvOptions};
use wad_cosim::eyes::Eyes;
use wad_cosim::latent::PooledEncoder;
use wad_cosim::perception::{EgoFacts, LeastScore};
use wad_cosim::seeds;
use wad_cosim::session::{Act, Itinerary, Seat, Session};
use wad_cosim::tasks::{TaskKind, TaskSpec};
use wad_cosim::traffic::{Counts, TrafficSpec};
use wad_cosim::vehicle::Control;

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

/// Two egos on the same route, the second 25 m before the first.
async fn two_egos(assets: &Arc<Assets>, folder: &Path) -> Session {
    let mut itinerary = Itinerary::new(assets.network(), seeds::rng(5, "route")).unwrap();
    let route = itinerary.first_route(assets.network()).unwrap();
    let seat = |id: &str, s: f64| {
        let (ego, autopilot, criteria) = Default::default();
        let mut seat = Seat::new(assets, id, ego, autopilot, criteria, route.clone());
        seat.place(route.clone(), s, (0.0, 0.0));
        seat
    };
    let options = BridgeOptions {
        traffic: TrafficSpec::Counts(Counts::new(5, 0)),
        ..BridgeOptions::new(assets.config(), folder.join("sumo"))
    };
    Session::start(assets, &options, vec![seat("first", 5.0), seat("second", 30.0)]).await.unwrap()
}

fn sees(session: &Session, me: usize, other: &str) -> bool {
    session.ego(me).world().vehicles.iter().any(|actor| &*actor.id == other)
}

#[test]
fn egos_of_a_session_act_for_themselves_and_see_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let assets = Assets::load("town3").unwrap();
    runtime().block_on(async {
        let mut session = two_egos(&assets, folder.path()).await;
        let parked = Control { brake: 1.0, ..Control::default() };
        let (mut collided, mut seen) = ([false; 2], [false; 2]);
        for _ in 0..60 {
            // Along the route, but with no brake.
            let gas = Control { throttle: 0.5, brake: 0.0, ..session.plan(0).control };
            let ticks = session.step(&[Act::Disturbed(gas), Act::Control(parked)]).await.unwrap();
            assert_eq!((ticks[0].control, ticks[1].control), (gas, parked));
            seen[0] |= sees(&session, 0, "second");
            seen[1] |= sees(&session, 1, "first");
            for (collided, tick) in collided.iter_mut().zip(&ticks) {
                *collided |= tick.events.iter().any(|event| matches!(event, Event::Collision { .. }));
            }
        }
        assert_eq!(seen, [true; 2], "each ego sees the other");
        assert!(collided[0], "an ego that drives into another one has collided");
        session.close().await.unwrap();
    });
    // With the expert at both wheels nobody drives into anybody.
    let folder = tempfile::tempdir().unwrap();
    runtime().block_on(async {
        let mut session = two_egos(&assets, folder.path()).await;
        for _ in 0..120 {
            let ticks = session.step(&[Act::Expert, Act::Expert]).await.unwrap();
            assert!(ticks.iter().all(|tick| tick.decision.is_some()));
            let collision = |tick: &wad_cosim::session::Tick| {
                tick.events.iter().any(|event| matches!(event, Event::Collision { .. }))
            };
            assert!(!ticks.iter().any(collision));
        }
        assert!(session.ego(1).on_route().s > 60.0, "the second has driven on");
        session.close().await.unwrap();
    });
}

/// Pictures (and latents of them) of `ticks` ticks under the expert.
fn pictures(env: &mut Env, task: &TaskSpec, seed: u64, ticks: usize) -> Vec<(Vec<u8>, Vec<f32>)> {
    let mut seen = vec![(Vec::new(), env.reset(task, seed).unwrap().concat())];
    for _ in 0..ticks {
        let step = env.act(Act::Expert).unwrap();
        seen.push((env.frame().unwrap().rgb.clone(), step.observation.concat()));
        if step.info.ending.is_some() {
            break;
        }
    }
    seen
}

/// The renderer's map of shadows once kept texels of the episode before: results differed with `--jobs`, order
/// and `--resume`.
#[test]
fn what_an_agent_sees_does_not_depend_on_the_episodes_before() {
    let assets = Assets::load("town5").unwrap();
    let traffic = Some(TrafficSpec::Counts(Counts::new(10, 10)));
    let task = TaskSpec { traffic, weather: Preset::ClearSunset, ..TaskSpec::new(TaskKind::Composite) };
    let new = || {
        Env::new(Arc::clone(&assets), EnvOptions::evaluation(), Box::new(PooledEncoder))
            .expect("an environment")
    };
    let mut old = new();
    for seed in [1, 2, 3] {
        pictures(&mut old, &task, seed, 90);
    }
    let (mut again, mut first) = (pictures(&mut old, &task, 4, 120), pictures(&mut new(), &task, 4, 120));
    assert!(first.len() > 100);
    assert_eq!(again.len(), first.len());
    for (tick, (again, first)) in again.drain(..).zip(first.drain(..)).enumerate() {
        assert!(again.0 == first.0, "tick {tick}: the picture shows an earlier episode");
        assert!(again.1 == first.1, "tick {tick}: the observation shows an earlier episode");
    }
}

/// Every town has one look: a film made with another seed shows what an agent sees.
#[test]
fn a_film_shows_what_the_agent_sees_whatever_the_seed() {
    let dir = tempfile::tempdir().unwrap();
    let film = dir.path().join("film/");
    let (film_arg, out) = (format!("{}/", film.display()), dir.path().join("run"));
    let out = out.to_string_lossy();
    let common = ["--traffic", "6,6", "--seed", "7", "--ticks", "12", "--weather", "ClearSunset"];
    let mut args = vec!["run", "town3", "--record", &film_arg, "--record-view", "front", "--out", &out];
    args.extend(common);
    let output = wad(&args).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    // The same drive again, seen through an agent's eyes.
    let assets = Assets::load("town3").unwrap();
    let bridge = BridgeOptions {
        seed: 7,
        traffic: TrafficSpec::Counts(Counts::new(6, 6)),
        ..BridgeOptions::new(assets.config(), dir.path().join("sumo"))
    };
    let options = wad_cosim::drive::DriveOptions::new(bridge, dir.path().join("again"));
    let detector = wad_cosim::perception::detector("truth", LeastScore::Usual).unwrap();
    let eyes = wad_cosim::eyes::Eyes::new(assets.town(), Default::default(), detector).unwrap();
    runtime().block_on(async {
        let mut drive = wad_cosim::drive::Drive::start(options).await.unwrap();
        drive.set_weather(Preset::ClearSunset);
        drive.watch_with(eyes);
        for number in 0..12 {
            drive.tick().await.unwrap();
            let seen = drive.look().unwrap().frame().unwrap();
            let path = film.join(format!("frame-{number:06}.png"));
            let mut reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&path).unwrap()))
                .read_info()
                .unwrap();
            let mut filmed = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut filmed).unwrap();
            assert_eq!(filmed.len(), seen.rgb.len());
            assert!(filmed == seen.rgb, "picture {number} of the film is not what the eyes see");
        }
        drive.finish(false).await.unwrap();
    });
}

/// `run` once drew the next route on arrival: the lane and the light behind the destination were news at full speed.
#[test]
fn a_drive_knows_its_way_on_before_it_arrives() {
    let dir = tempfile::tempdir().unwrap();
    let assets = Assets::load("town5").unwrap();
    let bridge = BridgeOptions {
        seed: 5,
        traffic: TrafficSpec::Counts(Counts::new(0, 0)),
        ..BridgeOptions::new(assets.config(), dir.path().join("sumo"))
    };
    let options = wad_cosim::drive::DriveOptions::new(bridge, dir.path().join("run"));
    runtime().block_on(async {
        let mut drive = wad_cosim::drive::Drive::start(options).await.unwrap();
        let mut arrivals = 0;
        while arrivals < 3 {
            let before = drive.ego().route().clone();
            let record = drive.tick().await.unwrap().record;
            assert!(record.tick < 6000, "{arrivals} arrivals");
            let (at, route) = (drive.ego().on_route().s, drive.ego().route());
            assert!(route.length() - at > 200.0, "only {:.0} m are known", route.length() - at);
            if !record.events.contains(&Event::Arrival) {
                assert!(drive.destination_s() - at > 4.9);
                continue;
            }
            arrivals += 1;
            assert!(record.route.length - record.route.s < 5.0);
            assert!(drive.destination_s() - at > 250.0, "the next destination is another one");
            assert!(at < record.route.s, "what was passed is dropped");
            for ahead in 0..100 {
                let (old, new) =
                    (before.at(record.route.s + f64::from(ahead)), route.at(at + f64::from(ahead)));
                assert!((old.pose.xy() - new.pose.xy()).norm() < 0.05, "{ahead} m ahead");
            }
        }
        let summary = drive.finish(false).await.unwrap();
        assert_eq!(summary.destinations_reached, 3);
    });
}

#[test]
fn run_knows_the_drivers_that_eval_knows() {
    let dir = tempfile::tempdir().unwrap();
    for driver in ["random", "constant", "constant:0.3,0,0"] {
        let out = dir.path().join(driver);
        let out = out.to_string_lossy();
        let args = [
            "run",
            "town3",
            "--agent",
            driver,
            "--traffic",
            "empty",
            "--ticks",
            "20",
            "--json",
            "--out",
            &out,
        ];
        let output = wad(&args).output().unwrap();
        assert!(output.status.success(), "{driver}: {}", stderr(&output));
        assert_eq!(json(&output)["ticks"], 20);
        let config = std::fs::read_to_string(Path::new(&*out).join("config.json")).unwrap();
        let config: serde_json::Value = serde_json::from_str(&config).unwrap();
        assert_eq!(config["driver"]["agent"], driver);
    }
    let output = wad(&["run", "town3", "--agent", "manual", "--ticks", "1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("--view"), "{}", stderr(&output));
    let output = wad(&["eval", "tasks", "--agent", "manual", "--episodes", "1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("manual"), "{}", stderr(&output));
}

/// The promise of docs/evaluate.md, with an agent that looks, in a sunny weather.
#[cfg(feature = "learn")]
#[test]
fn results_of_an_agent_that_looks_do_not_depend_on_jobs_shards_or_resume() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        let mut command = wad(&["eval", "tasks", "--task", "one_turn", "--condition", "new"]);
        command.args(["--weather", "WetSunset", "--episodes", "3", "--agent", "wad-t"]);
        let output = command.args(more).arg("--out").arg(&out).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        out.join("episodes.jsonl")
    };
    let lines = |files: &[std::path::PathBuf]| -> Vec<String> {
        let text: String = files.iter().map(|file| std::fs::read_to_string(file).unwrap()).collect();
        let mut lines: Vec<String> = text.lines().map(str::to_string).collect();
        lines.sort();
        lines
    };
    let one = run("one", &["--jobs", "1"]);
    let whole = lines(std::slice::from_ref(&one));
    assert_eq!(whole.len(), 3);
    let same = |what: &str, other: Vec<String>| {
        assert!(whole == other, "{what}: the same episodes, other results:\n{whole:#?}\n{other:#?}");
    };
    same("two jobs", lines(&[run("two", &["--jobs", "2"])]));
    // Each shard begins with another episode.
    same("shards", lines(&[run("first", &["--shard", "1/2"]), run("second", &["--shard", "2/2"])]));
    // Only the second is missing: no episode was driven before it.
    let text = std::fs::read_to_string(&one).unwrap();
    let kept: Vec<&str> = text.lines().enumerate().filter(|(n, _)| *n != 1).map(|(_, line)| line).collect();
    std::fs::write(&one, kept.join("\n") + "\n").unwrap();
    same("resumed", lines(&[run("one", &["--resume"])]));
}

/// The gaps (m) to who is in front, and to who will cross, with boxes from shapes against those with drawn boxes, at every tick of
/// a drive.
fn gaps(town: &str, seed: u64, counts: Counts) -> Vec<[[Option<f64>; 2]; 2]> {
    let folder = tempfile::tempdir().unwrap();
    let assets = Assets::load(town).unwrap();
    let mut eyes = ["truth", "outlines"].map(|name| {
        let detector = wad_cosim::perception::detector(name, LeastScore::Usual).unwrap();
        let mut eyes = Eyes::new(assets.town(), CameraConfig::default(), detector).unwrap();
        eyes.reset(Preset::ClearNoon, seed);
        eyes
    });
    runtime().block_on(async {
        let mut itinerary = Itinerary::new(assets.network(), seeds::rng(seed, "route")).unwrap();
        let route = itinerary.first_route(assets.network()).unwrap();
        let (ego, autopilot, criteria) = Default::default();
        let seat = Seat::new(&assets, "ego", ego, autopilot, criteria, route);
        let options = BridgeOptions {
            seed,
            traffic: TrafficSpec::Counts(counts),
            ..BridgeOptions::new(assets.config(), folder.path().join("sumo"))
        };
        let mut session = Session::start(&assets, &options, vec![seat]).await.unwrap();
        let mut gaps = Vec::new();
        for _ in 0..450 {
            let tick = session.step_one(Act::Expert).await.unwrap();
            let facts = EgoFacts::of(assets.network(), session.ego(0), session.bridge().tick());
            let look = |eyes: &mut Eyes| {
                eyes.follow(session.ego(0).world());
                eyes.look(&facts).unwrap();
                let percept = eyes.percept().unwrap();
                [percept.lead, percept.crossing].map(|one| one.map(|one| one.gap))
            };
            let [truth, outlines] = eyes.each_mut().map(look);
            gaps.push([[truth[0], outlines[0]], [truth[1], outlines[1]]]);
            if tick.events.contains(&Event::Arrival) {
                break;
            }
        }
        session.close().await.unwrap();
        gaps
    })
}

/// What `train agent --inputs raw` sees without drawing is what the renderer's boxes show.
#[test]
fn outlines_show_the_vehicle_in_front_that_the_picture_shows() {
    let drives = [("town3", 3, Counts::new(100, 250)), ("town5", 4, Counts::new(70, 150))];
    let gaps: Vec<_> = drives.into_iter().flat_map(|(town, seed, counts)| gaps(town, seed, counts)).collect();
    let some = gaps.iter().filter(|both| both.iter().any(|[truth, _]| truth.is_some())).count();
    assert!(some > 200, "{some} of {} ticks have somebody", gaps.len());
    for (index, what) in ["in front", "to cross"].into_iter().enumerate() {
        let same = gaps.iter().filter(|both| match both[index] {
            [Some(truth), Some(outlines)] => (truth - outlines).abs() < 0.3,
            [truth, outlines] => truth.is_none() && outlines.is_none(),
        });
        let same = same.count();
        assert!(same * 100 >= 95 * gaps.len(), "{what}: equal in {same} of {} ticks", gaps.len());
    }
}
