//! `wad-cosim report learning`: learning curves of trainings, with their seeds as a band.

use crate::cli::{Exit, print};
use anyhow::Context;
use clap::ValueHint;
use serde_json::Value;
use std::path::{Path, PathBuf};
use wad_cosim::eval::report::{Chart, Line, Table, markdown};
use wad_cosim::train::agent::Curve;

/// Draw learning curves of trainings. Those that differ in their seed alone become one line with a band.
#[derive(clap::Args, Debug)]
#[command(after_help = "Example:\n  wad-cosim report learning runs/t1 runs/t2 --out pictures")]
pub struct Args {
    /// Folders that `train agent` wrote.
    #[arg(value_name = "RUN", required = true, value_hint = ValueHint::DirPath)]
    runs: Vec<PathBuf>,
    /// Folder for learning-success.svg, learning-return.svg, learning-stage.svg and learning.md.
    #[arg(long, value_name = "DIR", default_value = ".", value_hint = ValueHint::DirPath)]
    out: PathBuf,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let curves: Vec<Curve> = args
        .runs
        .iter()
        .map(|run| Curve::load(run).map_err(|e| Exit::Input.because(e)))
        .collect::<anyhow::Result<_>>()?;
    std::fs::create_dir_all(&args.out)
        .map_err(|e| Exit::Input.because(e))
        .with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let curves = told_apart(curves);
    let mut groups: Vec<Vec<&Curve>> = Vec::new();
    for curve in &curves {
        match groups.iter_mut().find(|group| group[0].made == curve.made) {
            Some(group) => group.push(curve),
            None => groups.push(vec![curve]),
        }
    }
    type Part = fn(&Curve) -> Vec<(f64, f64)>;
    let parts: [(&str, &str, Part); 3] = [
        ("success", "success in the last 40 training episodes", Curve::success),
        ("return", "mean return of the last 40 training episodes", Curve::returns),
        ("stage", "stages passed", Curve::stages),
    ];
    for (name, y, part) in parts {
        let chart = Chart {
            title: "Learning; band: from the worst to the best seed".to_string(),
            x: "environment steps".to_string(),
            y: y.to_string(),
            lines: groups.iter().map(|group| line(group, part)).collect(),
        };
        write(&args.out.join(format!("learning-{name}.svg")), &chart.svg())?;
    }
    write(&args.out.join("learning.md"), &markdown(&tables(&curves)))?;
    Ok(Exit::Done)
}

/// Most settings that a name tells.
const TOLD: usize = 3;

/// The curves; where others of the same name were made with other settings, the name tells them.
fn told_apart(mut curves: Vec<Curve>) -> Vec<Curve> {
    let others: Vec<(String, Value)> = curves.iter().map(|c| (c.name.clone(), c.made.clone())).collect();
    for curve in &mut curves {
        let mut told: Vec<String> = Vec::new();
        for (_, other) in others.iter().filter(|(name, _)| *name == curve.name) {
            differences("", &curve.made, other, &mut told);
        }
        for setting in told.iter().take(TOLD) {
            curve.name.push_str(&format!(", {setting}"));
        }
    }
    curves
}

/// Adds what of `mine`, a setting called `name`, is not so in `other`: `latent_gain 0.02`, of a list its length.
fn differences(name: &str, mine: &Value, other: &Value, told: &mut Vec<String>) {
    let setting = match (mine, other) {
        _ if mine == other => return,
        (Value::Object(mine), Value::Object(other)) => {
            for (name, value) in mine {
                differences(name, value, other.get(name).unwrap_or(&Value::Null), told);
            }
            return;
        }
        (Value::Array(mine), Value::Array(other)) if mine.len() == other.len() => {
            for (mine, other) in mine.iter().zip(other) {
                differences(name, mine, other, told);
            }
            return;
        }
        (Value::Array(list), _) => format!("{} {name}", list.len()),
        (Value::String(text), _) => format!("{name} {text}"),
        _ => format!("{name} {mine}"),
    };
    if !told.contains(&setting) {
        told.push(setting);
    }
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    crate::cli::save(path, text)?;
    print(&format!("{}\n", path.display()))
}

/// Points of a line.
const POINTS: usize = 200;

/// The mean of a group's curves where all of them have a value, and their range.
fn line(group: &[&Curve], part: fn(&Curve) -> Vec<(f64, f64)>) -> Line {
    let curves: Vec<Vec<(f64, f64)>> = group.iter().map(|curve| part(curve)).collect();
    let ends = curves.iter().filter_map(|c| Some((c.first()?.0, c.last()?.0)));
    let (from, to) = ends.fold((0.0_f64, f64::INFINITY), |(a, b), (from, to)| (a.max(from), b.min(to)));
    let (mut points, mut band) = (Vec::new(), Vec::new());
    for i in 0..POINTS {
        let step = from + (to - from) * i as f64 / (POINTS - 1) as f64;
        let values: Vec<f64> = curves.iter().filter_map(|curve| at(curve, step)).collect();
        if values.len() == curves.len() && step.is_finite() {
            points.push((step, values.iter().sum::<f64>() / values.len() as f64));
            let range = values.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
            band.push([step, range.0, range.1]);
        }
    }
    let seeds: Vec<String> = group.iter().map(|curve| curve.seed.to_string()).collect();
    let word = if seeds.len() == 1 { "seed" } else { "seeds" };
    let name = format!("{}, {word} {}", group[0].name, seeds.join(", "));
    Line { name, points, band: if seeds.len() > 1 { band } else { Vec::new() } }
}

/// A curve's value at a step; None outside of it.
fn at(curve: &[(f64, f64)], step: f64) -> Option<f64> {
    let after = curve.partition_point(|point| point.0 < step);
    let (a, b) = (curve.get(after.saturating_sub(1))?, curve.get(after)?);
    let share = if b.0 > a.0 { (step - a.0) / (b.0 - a.0) } else { 1.0 };
    Some(a.1 + share.clamp(0.0, 1.0) * (b.1 - a.1))
}

/// When each stage was passed: a table for each list of stages.
fn tables(curves: &[Curve]) -> Vec<Table> {
    let mut alike: Vec<Vec<&Curve>> = Vec::new();
    for curve in curves {
        match alike.iter_mut().find(|group| group[0].tasks == curve.tasks) {
            Some(group) => group.push(curve),
            None => alike.push(vec![curve]),
        }
    }
    alike.iter().map(|group| table(group)).collect()
}

/// Of curves with the same stages.
fn table(curves: &[&Curve]) -> Table {
    let tasks = &curves[0].tasks;
    let mut head = vec!["training".to_string(), "seed".to_string(), "steps".to_string(), "hours".to_string()];
    head.extend(tasks.iter().cloned());
    let row = |curve: &&Curve| {
        let mut row = vec![
            curve.name.clone(),
            curve.seed.to_string(),
            curve.steps.to_string(),
            format!("{:.2}", curve.hours),
        ];
        row.extend((0..tasks.len()).map(|stage| {
            curve.passed.iter().find(|pass| pass.stage == stage).map_or("-".to_string(), |pass| {
                let how = if pass.threshold { "" } else { " (its steps were spent)" };
                format!("{} steps, {:.2} h{how}", pass.step, pass.hours)
            })
        }));
        row
    };
    Table {
        title: "Step and hour at which each stage's threshold was passed".to_string(),
        head,
        rows: curves.iter().map(row).collect(),
        ..Table::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn names_tell_in_what_settings_differ() {
        let mine = json!({"latent_gain": 0.02, "curriculum": {"stages": [{"task": "composite"}]}, "egos": 1});
        let other = json!({"latent_gain": 0.1, "curriculum": {"stages": [{}, {}]}, "egos": 1});
        let mut told = Vec::new();
        differences("", &mine, &other, &mut told);
        told.sort();
        assert_eq!(told, ["1 stages", "latent_gain 0.02"]);
        differences("", &mine, &mine, &mut told);
        assert_eq!(told.len(), 2);
    }
}
