//! Many egos in one SUMO, on a real one.

use std::collections::BTreeSet;
use std::sync::Arc;
use wad_cosim::assets::Assets;
use wad_cosim::bridge::Fetch;
use wad_cosim::env::{End, Env, EnvError, EnvOptions, Fleet, ObservationMode, WorldMode};
use wad_cosim::latent::{Encoder, PooledEncoder};
use wad_cosim::observation::{LIGHT_NEARNESS, RAW_SIZE};
use wad_cosim::session::Act;
use wad_cosim::tasks::{Placement, Spot, TaskKind, TaskSpec};
use wad_cosim::traffic::{Counts, TrafficSpec};
use wad_cosim::vehicle::Control;

fn encoders(egos: usize) -> Vec<Box<dyn Encoder>> {
    (0..egos).map(|_| Box::new(PooledEncoder) as Box<dyn Encoder>).collect()
}

fn vector() -> EnvOptions {
    EnvOptions { observation: ObservationMode::Vector, ..EnvOptions::training() }
}

fn composite(vehicles: usize, pedestrians: usize) -> TaskSpec {
    let traffic = Some(TrafficSpec::Counts(Counts::new(vehicles, pedestrians)));
    TaskSpec { traffic, ..TaskSpec::new(TaskKind::Composite) }
}

fn fleet(town: &str, options: EnvOptions, egos: usize) -> Fleet {
    Fleet::new(Assets::load(town).unwrap(), options, encoders(egos)).unwrap()
}

/// Bits of all that a fleet's drive under the expert gave.
fn drive(mut fleet: Fleet, tasks: &[TaskSpec], ticks: usize) -> Vec<u64> {
    let mut bits = Vec::new();
    let first = fleet.reset(tasks, 7).unwrap();
    bits.extend(first.iter().map(|x| u64::from(x.to_bits())));
    let acts = vec![Act::Expert; fleet.egos()];
    for _ in 0..ticks {
        let step = fleet.step(&acts).unwrap();
        bits.extend(step.rewards.iter().map(|x| x.to_bits()));
        bits.extend(step.began.iter().chain(&step.terminated).map(|x| u64::from(*x)));
        bits.extend(fleet.observations().iter().map(|x| u64::from(x.to_bits())));
    }
    fleet.close();
    bits
}

/// With one ego a fleet is today's environment: the same bytes, picture and latent included.
#[test]
fn a_fleet_of_one_is_an_environment() {
    let assets = Assets::load("town3").unwrap();
    let options = EnvOptions { world: WorldMode::Fresh, ..EnvOptions::training() };
    let task = composite(10, 10);
    let mut fleet = Fleet::new(Arc::clone(&assets), options.clone(), encoders(1)).unwrap();
    let mut env = Env::new(assets, options, Box::new(PooledEncoder)).unwrap();
    let first = env.reset(&task, Fleet::episode_seed(3, 0, 0)).unwrap();
    assert_eq!(fleet.reset(std::slice::from_ref(&task), 3).unwrap(), first.concat());
    for tick in 0..60 {
        let alone = env.act(Act::Expert).unwrap();
        let step = fleet.step(&[Act::Expert]).unwrap();
        assert_eq!(step.rewards[0].to_bits(), alone.reward.to_bits(), "tick {tick}");
        assert_eq!(format!("{:?}", step.infos[0]), format!("{:?}", alone.info), "tick {tick}");
        assert_eq!(fleet.observations(), alone.observation.concat(), "tick {tick}");
    }
}

/// Twelve egos drive on all cores; with one thread they drive the same.
#[test]
fn equal_seeds_give_equal_bytes_whatever_the_threads() {
    let task = [composite(20, 20)];
    let many = drive(fleet("town3", vector(), 12), &task, 80);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = one.install(|| drive(fleet("town3", vector(), 12), &task, 80));
    assert!(many == again, "the number of threads changes what a fleet does");
}

/// A road user's id, and its place (m).
type Placed = (String, [f64; 3]);

/// What all egos see is the same whether SUMO searches round each or sends all that moves.
#[test]
fn both_ways_to_fetch_bring_the_same_road_users() {
    let seen = |fetch: Fetch| {
        let mut fleet = fleet("town3", EnvOptions { fetch, ..vector() }, 5);
        fleet.reset(&[composite(30, 30)], 2).unwrap();
        let mut seen = Vec::new();
        for _ in 0..40 {
            fleet.step(&[Act::Control(Control::default()); 5]).unwrap();
            for ego in 0..5 {
                let world = fleet.ego(ego).unwrap().world();
                let users = world.vehicles.iter().chain(&world.pedestrians);
                let placed = users.map(|user| {
                    let at = user.pose.position;
                    (user.id.to_string(), [at.x, at.y, at.z])
                });
                seen.push(placed.collect::<Vec<_>>());
            }
        }
        fleet.close();
        seen
    };
    let (around, once) = (seen(Fetch::Around), seen(Fetch::Once));
    assert!(around.iter().map(Vec::len).sum::<usize>() > 400, "they see many");
    assert!(around.iter().flatten().any(|(id, _)| wad_cosim::env::is_ego(id)), "and each other");
    // How fast somebody who comes into sight changes speed may be known a tick later in one way, and then the motion of an ego beside
    // it differs by a rounding.
    for (look, (around, once)) in around.iter().zip(&once).enumerate() {
        let same =
            |(a, b): (&Placed, &Placed)| a.0 == b.0 && a.1.iter().zip(b.1).all(|(x, y)| (x - y).abs() < 1e-6);
        assert!(
            around.len() == once.len() && around.iter().zip(once).all(same),
            "look {look}: {around:?}, {once:?}"
        );
    }
}

/// Those whose episode ends begin anew elsewhere with the next step, and the others drive on.
#[test]
fn an_ego_whose_episode_ends_returns_elsewhere_without_a_pause_for_the_others() {
    let mut fleet = fleet("town3", vector(), 6);
    fleet.reset(&[TaskSpec::new(TaskKind::Straight), TaskSpec::new(TaskKind::OneTurn)], 1).unwrap();
    assert_eq!(fleet.task(3).kind, TaskKind::OneTurn);
    let (mut ended, mut began) = ([0; 6], [0; 6]);
    let mut ending = [false; 6];
    for tick in 1..=240 {
        let gas = Control { throttle: 0.6, ..Control::default() };
        // The first three go straight off the road in the end; the others drive well.
        let acts: Vec<Act> =
            (0..6).map(|ego| if ego < 3 { Act::Control(gas) } else { Act::Expert }).collect();
        let before: Vec<_> = (0..6).map(|ego| fleet.ego(ego).unwrap().state().pose.xy()).collect();
        let step = fleet.step(&acts).unwrap().clone();
        for ego in 0..6 {
            assert_eq!(
                step.began[ego], ending[ego],
                "ego {ego} at tick {tick}: it begins as soon as it ended"
            );
            ending[ego] = step.is_over(ego);
            ended[ego] += u32::from(step.is_over(ego));
            began[ego] += u32::from(step.began[ego]);
            let info = &step.infos[ego];
            if step.began[ego] {
                let moved = (fleet.ego(ego).unwrap().state().pose.xy() - before[ego]).norm();
                assert!(moved > 5.0, "ego {ego} begins elsewhere");
                assert_eq!((info.tick, step.rewards[ego], info.ego.speed), (0, 0.0, 0.0));
            }
            if step.is_over(ego) {
                assert!(info.ending.is_some());
            }
        }
    }
    assert!(ended[..3].iter().all(|count| *count > 0) && ended.iter().sum::<u32>() > 6, "{ended:?}");
    assert!(ended.iter().zip(&began).all(|(ended, began)| ended - began <= 1), "{ended:?} {began:?}");
    fleet.close();
}

/// It was once the first task's in a new SUMO, and the last one's in one that ran on.
#[test]
fn a_fleet_begins_in_the_largest_traffic_of_its_tasks() {
    let mut fleet = fleet("town3", vector(), 3);
    for seed in [1, 2] {
        fleet.reset(&[composite(0, 0), composite(12, 0), composite(3, 0)], seed).unwrap();
        let step = fleet.step(&[Act::Control(Control::default()); 3]).unwrap();
        let (vehicles, _) = step.infos[0].traffic;
        assert!((10..=12).contains(&vehicles), "seed {seed}: {vehicles} vehicles");
    }
    fleet.close();
}

/// A task's traffic was once ignored there.
#[test]
fn a_fleet_that_began_in_the_configs_own_traffic_gets_a_later_tasks() {
    let mut fleet = fleet("town3", vector(), 2);
    let own = TaskSpec { traffic: Some(TrafficSpec::AsIs), ..composite(0, 0) };
    fleet.reset(&[own], 1).unwrap();
    let brake = Act::Control(Control { brake: 1.0, ..Control::default() });
    let vehicles = |fleet: &mut Fleet| fleet.step(&[brake; 2]).unwrap().infos[0].traffic.0;
    let own: Vec<usize> = (0..90).map(|_| vehicles(&mut fleet)).collect();
    assert!(own[89] > 2, "{own:?}");
    fleet.set_next(0, composite(0, 0), 2);
    fleet.give_up(0);
    assert!((0..10).any(|_| vehicles(&mut fleet) == 0), "the config's vehicles leave");
    fleet.close();
}

/// A light's own program was asked for while SUMO still called it `online`, and that was restored.
#[test]
fn a_light_that_is_held_again_and_by_another_ego_gets_its_own_program_back() {
    let mut fleet = fleet("town3", vector(), 2);
    let network = Arc::clone(fleet.assets().network());
    let light = network.traffic_light_by_id("gate").unwrap();
    let task = |kind: TaskKind, s: f64| {
        let [from, to] =
            [("nw1-gate_1", s), ("fast-ne1_1", 250.0)].map(|(lane, s)| Spot { lane: lane.into(), s });
        let placement = Placement { from, to, via: Vec::new(), obstacle: None };
        TaskSpec { placement: Some(placement), tick_limit: Some(2), ..TaskSpec::new(kind) }
    };
    fleet.reset(&[task(TaskKind::Straight, 10.0), task(TaskKind::Straight, 45.0)], 1).unwrap();
    let mut signals =
        fleet.ego(0).unwrap().route().links.iter().filter_map(|link| network.link(link.link).signal);
    let head = signals.find(|signal| signal.traffic_light == light).unwrap().index;
    // Two ticks of each episode, and one in which both egos begin again; what the light shows in the last one.
    let episodes = |fleet: &mut Fleet| {
        let brake = Act::Control(Control { brake: 1.0, ..Control::default() });
        for began in [false, false, true] {
            assert_eq!(fleet.step(&[brake; 2]).unwrap().began, [began; 2]);
        }
        fleet.ego(0).unwrap().world().traffic_lights[light.index()].clone().unwrap()
    };
    let held = episodes(&mut fleet);
    assert_eq!(held.as_bytes()[head], b'G', "held for the first ego again: {held}");
    fleet.set_next(0, task(TaskKind::Navigation, 10.0), 2);
    assert_eq!(episodes(&mut fleet), held, "held for the second");
    fleet.set_next(1, task(TaskKind::Navigation, 45.0), 3);
    let shown: BTreeSet<_> = (0..240).map(|_| episodes(&mut fleet)).collect();
    assert!(shown.len() > 2, "its program goes on: {shown:?}");
    fleet.close();
}

/// Both of two egos that collide are told, and it counts as a collision between egos.
#[test]
fn both_egos_of_a_crash_are_told() {
    let mut fleet = fleet("town3", vector(), 14);
    fleet.reset(&[composite(0, 0)], 5).unwrap();
    let mut crashes = 0;
    for _ in 0..3000 {
        if crashes > 1 {
            break;
        }
        // They follow their routes, blind for others, on green and on red.
        let acts: Vec<Act> = fleet
            .observations()
            .chunks_exact(fleet.observation_size())
            .map(|row| {
                let raw = &row[row.len() - RAW_SIZE..];
                assert!(raw[LIGHT_NEARNESS] <= 1.0);
                let steer = f64::from(1.3 * raw[9]).clamp(-1.0, 1.0);
                let slow = raw[0] < 0.5;
                Act::Control(Control {
                    throttle: if slow { 0.5 } else { 0.0 },
                    brake: 0.0,
                    steer,
                    reverse: false,
                })
            })
            .collect();
        let step = fleet.step(&acts).unwrap();
        let hit: Vec<usize> = (0..14)
            .filter(|&ego| {
                step.infos[ego].events.iter().any(|event| {
                    let text = format!("{event:?}");
                    text.contains("Collision") && text.contains("partner: \"ego")
                })
            })
            .collect();
        if !hit.is_empty() {
            assert!(hit.len() >= 2, "only {hit:?} were told");
            assert_eq!(step.ego_collisions(), hit.len());
            crashes += 1;
        }
    }
    assert!(crashes > 0, "fourteen blind egos never met in 3000 ticks");
    fleet.close();
}

/// The id of the process that is gone.
fn kill_sumo(fleet: &Fleet) -> u32 {
    let pid = fleet.sumo_pid().unwrap();
    // SAFETY: a signal to a child process of this test.
    unsafe { libc::kill(pid as i32, libc::SIGKILL) };
    pid
}

/// A SUMO that is killed costs every ego its episode, with a reason; the fleet comes back with a new one.
#[test]
fn a_killed_sumo_truncates_every_episode_and_the_fleet_comes_back() {
    let mut fleet = fleet("town3", vector(), 3);
    fleet.reset(&[composite(5, 5)], 4).unwrap();
    let acts = [Act::Expert; 3];
    fleet.step(&acts).unwrap();
    let pid = kill_sumo(&fleet);
    let step = fleet.step(&acts).unwrap();
    assert_eq!((&step.truncated, &step.terminated), (&vec![true; 3], &vec![false; 3]));
    for info in &step.infos {
        let ending = info.ending.as_ref().unwrap();
        assert!(ending.end == End::Error && ending.cause.contains("SUMO"), "{ending:?}");
    }
    let step = fleet.step(&acts).unwrap();
    assert_eq!((&step.began, &step.truncated), (&vec![true; 3], &vec![false; 3]));
    assert_ne!(fleet.sumo_pid(), Some(pid));
    for _ in 0..10 {
        assert!(fleet.step(&acts).unwrap().infos.iter().all(|info| info.ending.is_none() && info.tick > 0));
    }
    fleet.close();
}

/// It was once an error of this step and of all that followed.
#[test]
fn a_sumo_that_is_dead_when_an_ego_begins_again_truncates_the_others_episodes() {
    let mut fleet = fleet("town3", vector(), 3);
    let short = TaskSpec { tick_limit: Some(1), ..composite(5, 5) };
    fleet.reset(&[composite(5, 5), short, composite(5, 5)], 4).unwrap();
    let acts = [Act::Expert; 3];
    assert!(fleet.step(&acts).unwrap().is_over(1));
    kill_sumo(&fleet);
    let step = fleet.step(&acts).unwrap();
    assert_eq!((&step.truncated, &step.began), (&vec![true, false, true], &vec![false; 3]));
    let ending = step.infos[0].ending.as_ref().unwrap();
    assert!(ending.end == End::Error && ending.cause.contains("SUMO"), "{ending:?}");
    assert_eq!(fleet.step(&acts).unwrap().began, [true; 3]);
    fleet.close();
}

/// Each once stayed where its episode had ended, on the other's start, and waited for ever.
#[test]
fn egos_that_stand_on_each_others_starts_both_begin_again() {
    let mut fleet = fleet("town3", vector(), 2);
    let task = |s: f64| {
        let [from, to] =
            [("nw1-gate_1", s), ("fast-ne1_1", 250.0)].map(|(lane, s)| Spot { lane: lane.into(), s });
        let placement = Placement { from, to, via: Vec::new(), obstacle: None };
        TaskSpec { placement: Some(placement), tick_limit: Some(3), ..composite(0, 0) }
    };
    fleet.reset(&[task(10.0), task(45.0)], 1).unwrap();
    fleet.set_next(0, task(45.0), 2);
    fleet.set_next(1, task(10.0), 3);
    let brake = Act::Control(Control { brake: 1.0, ..Control::default() });
    for _ in 0..3 {
        assert_eq!(fleet.step(&[brake; 2]).unwrap().began, [false; 2]);
    }
    assert_eq!(fleet.step(&[brake; 2]).unwrap().began, [false, true]);
    assert!(fleet.ego(0).unwrap().is_away(), "it waits off the road");
    assert_eq!(fleet.step(&[brake; 2]).unwrap().began, [true, false]);
    let step = fleet.step(&[brake; 2]).unwrap();
    assert_eq!(step.infos.iter().map(|info| info.tick).collect::<Vec<_>>(), [1, 2]);
    assert!(!fleet.ego(0).unwrap().is_away());
    fleet.close();
}

/// More egos than the town has room for: how many fit.
#[test]
fn a_town_that_is_too_small_says_how_many_egos_fit() {
    let mut fleet = fleet("town3", vector(), 400);
    let error = fleet.reset(&[TaskSpec::new(TaskKind::Roundabout)], 1).unwrap_err();
    assert!(error.is_input(), "{error}");
    let EnvError::Full { egos, fit, .. } = &error else { panic!("{error}") };
    assert!((*egos, (1..400).contains(fit)) == (400, true), "{error}");
    assert!(error.to_string().contains(&format!("room for {fit} egos")), "{error}");
}
