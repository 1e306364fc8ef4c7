//! `wad-cosim report reward`: the pictures of docs/reward.md.

use super::plot::{Chart, Line};
use crate::cli::{Exit, print};
use anyhow::Context;
use clap::ValueHint;
use std::path::PathBuf;
use wad_cosim::observation::LeadState;
use wad_cosim::reward::{self, Facts, Light, RewardParams};

/// The reward's six terms over what they depend on, as SVG.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// Folder for the pictures.
    #[arg(long, value_name = "DIR", default_value = "docs/img", value_hint = ValueHint::DirPath)]
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
        std::fs::write(&path, chart.svg())
            .map_err(|e| Exit::Input.because(e))
            .with_context(|| format!("cannot write {}", path.display()))?;
        print(&format!("{}\n", path.display()))?;
    }
    Ok(Exit::Done)
}

fn chart(title: &str, x: &str, lines: Vec<Line>) -> Chart {
    Chart { title: title.to_string(), x: x.to_string(), y: "reward per tick".to_string(), lines }
}

fn charts(p: &RewardParams) -> Vec<(&'static str, Chart)> {
    let speeds = (0.0, 18.0);
    let at = |speed: f64| Facts::cruising(speed, LIMIT);
    let behind = |gap: f64, other: f64| {
        move |speed: f64| Facts {
            lead: Some(LeadState { gap, closing_speed: speed - other }),
            ..Facts::cruising(speed, LIMIT)
        }
    };
    let red = |distance: f64| {
        move |speed: f64| Facts {
            light: Some(Light { distance, red: true }),
            ..Facts::cruising(speed, LIMIT)
        }
    };
    let driving = |name: &str, facts: &dyn Fn(f64) -> Facts| {
        Line::of(name, speeds, 361, |v| reward::longitudinal(p, &facts(v)))
    };
    let smooth = |name: &str, change: &dyn Fn(&mut Facts, f64)| {
        Line::of(name, (0.0, 1.0), 101, |share| {
            let mut facts = at(8.0);
            change(&mut facts, share);
            reward::smoothness(p, &facts)
        })
    };
    let approach = |name: &str, speed: f64| {
        Line::of(name, (0.0, 25.0), 251, move |distance| reward::light(p, &red(distance)(speed)))
    };
    vec![
        (
            "timeout",
            chart(
                "r_timeout: once, terminal",
                "seconds stood for no reason (training: 30 s are too many)",
                vec![Line::of("timeout", (0.0, 40.0), 401, |t| reward::timeout(p, (t - 30.0).abs() < 0.05))],
            ),
        ),
        (
            "collision",
            chart(
                "r_collision: once, terminal",
                "impulse (N s)",
                vec![Line::of("collision", (0.0, 15_000.0), 301, |i| reward::collision(p, Some(i)))],
            ),
        ),
        (
            "lane",
            chart(
                "r_lane (-25 once beyond 1.75 m, where that ends the episode)",
                "distance from the lane's centre (m)",
                vec![Line::of("lane", (0.0, 2.5), 251, |d| reward::lane(p, d, false))],
            ),
        ),
        (
            "speed",
            chart(
                "r_speed, longitudinal; limit 50 km/h",
                "speed (m/s)",
                vec![
                    driving("empty road", &at),
                    driving("20 m behind a vehicle at 6 m/s", &behind(20.0, 6.0)),
                    driving("15 m before a standing vehicle", &behind(15.0, 0.0)),
                    driving("5 m before a standing vehicle", &behind(5.0, 0.0)),
                    driving("15 m before a red light", &red(15.0)),
                    driving("before a bend for 5 m/s", &|v| Facts { curve_speed: 5.0, ..at(v) }),
                ],
            ),
        ),
        (
            "smoothness",
            chart(
                "r_speed, lateral and comfort",
                "share of full lock, or of 6 m/s2",
                vec![
                    smooth("steering beside what the bend needs", &|f, x| {
                        (f.steer, f.previous_steer) = (x, x);
                    }),
                    smooth("change of steering in a tick", &|f, x| {
                        (f.steer, f.curve_steer) = (x, x);
                    }),
                    smooth("acceleration held", &|f, x| {
                        (f.acceleration, f.previous_acceleration) = (6.0 * x, 6.0 * x);
                    }),
                    smooth("acceleration from none in a tick", &|f, x| f.acceleration = 6.0 * x),
                ],
            ),
        ),
        (
            "light",
            chart(
                "r_light before a red light",
                "distance to the stop line (m)",
                vec![
                    approach("standing", 0.0),
                    approach("at 5 m/s", 5.0),
                    approach("at 8 m/s", 8.0),
                    approach("at 11 m/s", 11.0),
                ],
            ),
        ),
        (
            "red",
            chart(
                "r_light when the line is crossed on red: once, terminal",
                "speed (m/s)",
                vec![Line::of("red", speeds, 181, |v| {
                    reward::light(p, &Facts { ran_red: true, ..red(0.0)(v) })
                })],
            ),
        ),
        ("steps", chart("r_steps", "tick", vec![Line::of("steps", (0.0, 100.0), 2, |_| reward::steps(p))])),
    ]
}
