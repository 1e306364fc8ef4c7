//! `wad-cosim report reward`: the pictures of docs/reward.md.

use crate::cli::{Exit, print};
use anyhow::Context;
use clap::ValueHint;
use std::path::PathBuf;
use wad_cosim::eval::report::{Chart, Line};
use wad_cosim::observation::LeadState;
use wad_cosim::reward::{self, Facts, Light, RewardParams};

/// Plot the reward's six terms as SVG.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Example, which draws those of docs/reward.md:\n  wad-cosim report reward --out docs/img"
)]
pub struct Args {
    /// Folder for the pictures, made if it is missing.
    #[arg(long, value_name = "DIR", default_value = ".", value_hint = ValueHint::DirPath)]
    out: PathBuf,
}

/// 50 km/h.
const LIMIT: f64 = 13.89;

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let folder = &args.out;
    std::fs::create_dir_all(folder)
        .map_err(|e| Exit::Input.because(e))
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    for (name, chart) in charts(&RewardParams::default()) {
        let path = folder.join(format!("reward-{name}.svg"));
        crate::cli::save(&path, &chart.svg())?;
        print(&format!("{}\n", path.display()))?;
    }
    Ok(Exit::Done)
}

fn charts(p: &RewardParams) -> Vec<(&'static str, Chart)> {
    let chart = |name: &'static str, title: &str, x: &str, lines: Vec<Line>| {
        (name, Chart { title: title.to_string(), x: x.to_string(), y: "reward per tick".to_string(), lines })
    };
    let one = |name: &str, range: (f64, f64), points: usize, f: &dyn Fn(f64) -> f64| {
        vec![Line::of(name, range, points, f)]
    };
    let stood = "seconds stood without a reason (training ends after 4 s)";
    let timeout = one("timeout", (0.0, 10.0), 201, &|t| reward::timeout(p, (t - 4.0).abs() < 0.03));
    let collision = one("collision", (0.0, 15_000.0), 301, &|i| reward::collision(p, Some(i)));
    let at = |name: &str, way: f64| Line::of(name, (0.0, 2.5), 251, |d| reward::lane(p, d, false, way));
    let lane = vec![at("at the wanted speed", 1.0), at("at half of it", 0.5), at("standing", 0.0)];
    let lane_title = "r_lane (-10 once beyond 1.75 m, where that ends the episode)";
    let ran_red = |v: f64| reward::light(p, &Facts { ran_red: true, ..before_red(0.0, v) });
    let red = one("red", SPEEDS, 181, &ran_red);
    let steps = one("steps", (0.0, 100.0), 2, &|_| reward::steps(p));
    vec![
        chart("timeout", "r_timeout: once, terminal", stood, timeout),
        chart("collision", "r_collision: once, terminal", "impulse (N s)", collision),
        chart("lane", lane_title, "distance from the lane's centre (m)", lane),
        chart("speed", "r_speed, longitudinal; limit 50 km/h", "speed (m/s)", speed_lines(p)),
        chart(
            "smoothness",
            "r_speed, lateral and comfort",
            "share of full lock, or of 6 m/s2",
            smoothness_lines(p),
        ),
        chart("light", "r_light before a red light", "distance to the stop line (m)", light_lines(p)),
        chart("red", "r_light when the line is crossed on red: once, terminal", "speed (m/s)", red),
        chart("steps", "r_steps", "tick", steps),
    ]
}

/// Speeds of the plots (m/s).
const SPEEDS: (f64, f64) = (0.0, 18.0);

fn before_red(distance: f64, speed: f64) -> Facts {
    Facts { light: Some(Light { distance, red: true }), ..Facts::cruising(speed, LIMIT) }
}

fn speed_lines(p: &RewardParams) -> Vec<Line> {
    let behind = |gap: f64, other: f64| {
        move |speed: f64| Facts {
            lead: Some(LeadState { gap, closing_speed: speed - other }),
            ..Facts::cruising(speed, LIMIT)
        }
    };
    let driving = |name: &str, facts: &dyn Fn(f64) -> Facts| {
        Line::of(name, SPEEDS, 361, |v| reward::longitudinal(p, &facts(v)))
    };
    let bend = |v: f64| Facts { curve_speed: 5.0, ..Facts::cruising(v, LIMIT) };
    vec![
        driving("empty road", &|v| Facts::cruising(v, LIMIT)),
        driving("20 m behind a vehicle at 6 m/s", &behind(20.0, 6.0)),
        driving("15 m before a standing vehicle", &behind(15.0, 0.0)),
        driving("5 m before a standing vehicle", &behind(5.0, 0.0)),
        driving("15 m before a red light", &|v| before_red(15.0, v)),
        driving("before a bend for 5 m/s", &bend),
    ]
}

fn smoothness_lines(p: &RewardParams) -> Vec<Line> {
    let smooth = |name: &str, change: &dyn Fn(&mut Facts, f64)| {
        Line::of(name, (0.0, 1.0), 101, |share| {
            let mut facts = Facts::cruising(8.0, LIMIT);
            change(&mut facts, share);
            reward::smoothness(p, &facts)
        })
    };
    vec![
        smooth("steering beside what the bend needs", &|f, x| (f.steer, f.previous_steer) = (x, x)),
        smooth("change of steering in a tick", &|f, x| (f.steer, f.curve_steer) = (x, x)),
        smooth("acceleration held", &|f, x| {
            (f.acceleration, f.previous_acceleration) = (6.0 * x, 6.0 * x);
        }),
        smooth("acceleration from none in a tick", &|f, x| f.acceleration = 6.0 * x),
    ]
}

fn light_lines(p: &RewardParams) -> Vec<Line> {
    let approach = |name: &str, speed: f64| {
        Line::of(name, (0.0, 25.0), 251, |distance| reward::light(p, &before_red(distance, speed)))
    };
    vec![
        approach("standing", 0.0),
        approach("at 5 m/s", 5.0),
        approach("at 8 m/s", 8.0),
        approach("at 11 m/s", 11.0),
    ]
}
