//! The environment on a real SUMO: the same episode twice, the ends, and a SUMO that dies.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use wad_cosim::env::{Assets, End, Env, EnvError, EnvOptions, ObservationMode, Step};
use wad_cosim::latent::PooledEncoder;
use wad_cosim::tasks::{TaskKind, TaskSpec};
use wad_cosim::traffic::{Counts, TrafficSpec};
use wad_cosim::vehicle::Control;

fn env(assets: &Arc<Assets>, options: EnvOptions) -> Env {
    Env::new(Arc::clone(assets), options, Box::new(PooledEncoder)).expect("an environment")
}

fn blind(options: EnvOptions) -> EnvOptions {
    EnvOptions { observation: ObservationMode::Blind, ..options }
}

/// What the expert does on `task` until the episode ends, at most `ticks`.
fn drive(env: &mut Env, task: &TaskSpec, seed: u64, ticks: usize) -> (Vec<Vec<f32>>, Vec<Step>) {
    let mut observations = vec![env.reset(task, seed).expect("a start").concat()];
    let mut steps: Vec<Step> = Vec::new();
    while steps.len() < ticks && steps.last().is_none_or(|step| step.info.ending.is_none()) {
        let control = env.expert().expect("an episode");
        let step = env.step(control).expect("a step");
        observations.push(step.observation.concat());
        steps.push(step);
    }
    (observations, steps)
}

#[test]
fn equal_seeds_give_equal_episodes_to_the_bit() {
    let assets = Assets::load("town3").unwrap();
    let traffic = Some(TrafficSpec::Counts(Counts::new(30, 30)));
    let task = TaskSpec { traffic, ..TaskSpec::new(TaskKind::Composite) };
    let mut one = env(&assets, EnvOptions::evaluation());
    let mut two = env(&assets, EnvOptions::evaluation());
    let first = drive(&mut one, &task, 5, 40);
    let second = drive(&mut two, &task, 5, 40);
    let bits = |run: &(Vec<Vec<f32>>, Vec<Step>)| -> (Vec<Vec<u32>>, Vec<u64>) {
        let numbers = run.0.iter().map(|o| o.iter().map(|x| x.to_bits()).collect()).collect();
        (numbers, run.1.iter().map(|step| step.reward.to_bits()).collect())
    };
    assert_eq!(first.1.len(), 40);
    assert!(bits(&first) == bits(&second), "two environments with the same seed differ");
    // What was driven before leaves nothing behind.
    let third = drive(&mut two, &task, 5, 40);
    assert!(bits(&first) == bits(&third), "the second episode of an environment differs from its first");
    let other = drive(&mut two, &task, 6, 40);
    assert!(bits(&first) != bits(&other), "another seed gives another episode");
}

#[test]
fn the_expert_arrives_and_reckless_driving_ends_badly() {
    let assets = Assets::load("town3").unwrap();
    let mut env = env(&assets, blind(EnvOptions::training()));
    let (_, steps) = drive(&mut env, &TaskSpec::new(TaskKind::OneTurn), 3, 700);
    let last = steps.last().unwrap();
    let ending = last.info.ending.as_ref().unwrap();
    assert_eq!((ending.end, ending.success), (End::Arrival, true), "{}", ending.cause);
    assert!(last.truncated && !last.terminated);
    let sum: f64 = last.info.reward.values().iter().sum();
    assert!((sum - last.reward).abs() < 1e-9, "the named terms are the reward");

    env.reset(&TaskSpec::new(TaskKind::Straight), 4).unwrap();
    let control = Control { throttle: 1.0, steer: 0.6, brake: 0.0, reverse: false };
    let last = (0..100).map(|_| env.step(control).unwrap()).find(|step| step.terminated);
    let last = last.expect("full throttle and steering do not stay on a road");
    let ending = last.info.ending.unwrap();
    assert!(ending.end.is_terminal() && !ending.success, "{ending:?}");
    assert!(last.reward < -10.0, "it is paid at once: {}", last.reward);
    assert!(matches!(env.step(control), Err(EnvError::NoEpisode)), "nothing goes on after the end");
}

/// In as-is traffic there was once no obstacle, because SUMO did not have its type; and the count of vehicles grew with
/// each obstacle that was taken away.
#[test]
fn an_obstacle_stands_in_as_is_traffic_and_is_counted_once() {
    let net = concat!(env!("CARGO_MANIFEST_DIR"), "/sumo_nets/town3/town3.net.xml");
    let mut env = env(&Assets::load(net).unwrap(), blind(EnvOptions::training()));
    let task = TaskSpec { traffic: Some(TrafficSpec::AsIs), ..TaskSpec::new(TaskKind::Obstacle) };
    let mut counts = Vec::new();
    for seed in 0..6 {
        let (_, steps) = drive(&mut env, &task, seed, 2);
        counts.push(steps[1].info.traffic.0);
    }
    // None where it is a person.
    assert_eq!(counts.iter().max(), Some(&1), "{counts:?}");
}

#[test]
fn a_told_expert_also_follows_whom_an_agent_is_told_of() {
    let assets = Assets::load("town5").unwrap();
    let new = |told_lead| {
        let detector = "truth:faulty".to_string();
        env(&assets, EnvOptions { told_lead, detector, ..EnvOptions::evaluation() })
    };
    let (mut told, mut untold) = (new(true), new(false));
    let traffic = Some(TrafficSpec::Counts(Counts::new(70, 150)));
    let task = TaskSpec { traffic, ..TaskSpec::new(TaskKind::Composite) };
    told.reset(&task, 1).expect("a start");
    untold.reset(&task, 1).expect("a start");
    // The same drive, until the one is told of somebody whom the other does not see.
    for tick in 0..400 {
        let (with, without) = (told.expert().unwrap(), untold.expert().unwrap());
        if with != without {
            let wish = |control: Control| control.throttle - control.brake;
            assert!(wish(with) < wish(without), "tick {tick}: {with:?}, untold {without:?}");
            assert!(
                told.raw().lead.is_some(),
                "tick {tick}: nobody is told, and still {with:?}, {without:?}"
            );
            return;
        }
        told.step(with).expect("a step");
        assert!(untold.step(without).expect("a step").info.ending.is_none());
    }
    panic!("it never went by whom the agent is told of");
}

#[test]
fn a_sumo_that_dies_costs_one_episode() {
    let assets = Assets::load("town3").unwrap();
    let mut env = env(&assets, blind(EnvOptions::training()));
    let task = TaskSpec::new(TaskKind::Straight);
    let (_, steps) = drive(&mut env, &task, 1, 5);
    assert_eq!(steps.len(), 5);
    let pid = env.sumo_pid().expect("a SUMO");
    // SAFETY: sends a signal to the SUMO that this environment started.
    assert_eq!(unsafe { libc::kill(i32::try_from(pid).unwrap(), libc::SIGKILL) }, 0);
    let lost = (0..3).map(|_| env.step(Control::default()).unwrap()).find(|step| step.truncated);
    let lost = lost.expect("the loss is noticed");
    assert_eq!(lost.info.ending.as_ref().map(|ending| ending.end), Some(End::Error));
    assert!(!lost.terminated && lost.reward == 0.0);
    let (_, steps) = drive(&mut env, &task, 2, 5);
    assert_eq!(steps.len(), 5, "the next episode has a SUMO of its own");
    assert_ne!(env.sumo_pid(), Some(pid));
}

#[test]
fn a_step_that_waits_for_sumo_can_be_given_up() {
    let assets = Assets::load("town3").unwrap();
    // Longer than this test may take.
    let patient = EnvOptions { tick_timeout: 3600.0, ..EnvOptions::training() };
    let mut env = env(&assets, blind(patient));
    let asked = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&asked);
    env.give_up_when(move || counted.fetch_add(1, Ordering::Relaxed) == 1);
    let task = TaskSpec::new(TaskKind::Straight);
    assert_eq!(drive(&mut env, &task, 1, 5).1.len(), 5);
    let pid = env.sumo_pid().expect("a SUMO");
    // SAFETY: sends a signal to the SUMO that this environment started.
    assert_eq!(unsafe { libc::kill(i32::try_from(pid).unwrap(), libc::SIGSTOP) }, 0);
    let lost = env.step(Control::default()).unwrap();
    assert!(lost.truncated && lost.info.ending.is_some_and(|ending| ending.cause.contains("given up")));
    assert_eq!(asked.load(Ordering::Relaxed), 2);
    assert!(env.step(Control::default()).is_err(), "no episode runs");
    assert_eq!(drive(&mut env, &task, 2, 5).1.len(), 5);
    assert!(!std::path::Path::new(&format!("/proc/{pid}")).exists());
}

#[test]
fn a_task_that_a_net_has_no_place_for_says_why() {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("two.net.xml");
    let text = r#"<net version="1.20">
        <location netOffset="0,0" convBoundary="0,0,30,0" origBoundary="0,0,30,0" projParameter="!"/>
        <edge id="a" from="x" to="y" priority="1">
            <lane id="a_0" index="0" speed="13.9" length="30.00" shape="0,0 30,0"/>
        </edge>
        <junction id="x" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-3"/>
        <junction id="y" type="dead_end" x="30" y="0" incLanes="a_0" intLanes="" shape="30,0 30,-3"/>
    </net>"#;
    std::fs::write(&config, text).unwrap();
    let assets = Assets::load(&config.to_string_lossy()).unwrap();
    let mut env = env(&assets, blind(EnvOptions::evaluation()));
    let error = env.reset(&TaskSpec::new(TaskKind::Cross), 1).unwrap_err();
    assert!(error.is_input(), "{error}");
    assert!(error.to_string().contains("cross"), "{error}");
}
