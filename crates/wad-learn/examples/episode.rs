//! One episode with a control that never changes: prints the named reward terms once a second, and their
//! sums at the end.
//!
//!     cargo run --release --example episode -- town3 0.4

use std::error::Error;
use wad_learn::env::{Assets, Env, EnvOptions};
use wad_learn::reward::RewardTerms;
use wad_see::latent::PooledEncoder;
use wad_sim::tasks::{TaskKind, TaskSpec};
use wad_vehicle::Control;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let config = arguments.next().ok_or("usage: episode CONFIG [THROTTLE [STEER]]")?;
    let mut number = |default: f64| arguments.next().map_or(Ok(default), |number| number.parse());
    let control = Control { throttle: number(0.4)?, steer: number(0.0)?, brake: 0.0, reverse: false };

    let assets = Assets::load(&config)?;
    let mut env = Env::new(assets, EnvOptions::evaluation(), Box::new(PooledEncoder))?;
    let observation = env.reset(&TaskSpec::new(TaskKind::Straight), 7)?;
    println!("an observation has {} numbers", observation.concat().len());

    let (mut sums, mut total, mut printed) = (RewardTerms::default(), 0.0, 0.0);
    loop {
        let step = env.step(control)?;
        sums.add(&step.info.reward);
        total += step.reward;
        let seconds = step.info.tick as f64 * env.tick().as_secs_f64();
        if seconds >= printed + 1.0 {
            printed = seconds.floor();
            println!("{seconds:.3} s, {:.2} m/s: {}", step.info.ego.speed, named(&step.info.reward));
        }
        if let Some(ending) = &step.info.ending {
            let kind = if step.terminated { "terminated" } else { "truncated" };
            println!("{kind} after {} ticks: {}: {}", step.info.tick, ending.end.name(), ending.cause);
            break;
        }
    }
    println!("sums: {}", named(&sums));
    println!("return: {total:.3}");
    env.close();
    Ok(())
}

fn named(terms: &RewardTerms) -> String {
    let pairs = RewardTerms::NAMES.iter().zip(terms.values());
    pairs.map(|(name, value)| format!("{name} {value:.3}")).collect::<Vec<_>>().join(", ")
}
