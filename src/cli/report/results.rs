//! `wad-cosim report RUN...`: the results of evaluations.

use crate::cli::{Exit, agents, print};
use anyhow::Context;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use wad_cosim::driver::DriverSpec;
use wad_cosim::env::EnvOptions;
use wad_cosim::eval::Results;
use wad_cosim::eval::report::{self, Page, Pool, Report, Table};

/// Writes the report of `runs` into the folder `out`: `index.html`, `report.md`, `report.csv`, `report.tex`;
/// with `markdown` the Markdown there too.
pub fn run(
    runs: &[PathBuf],
    out: Option<&Path>,
    markdown: Option<&Path>,
    thumbnails: usize,
    pools: &[Pool],
    json: bool,
) -> anyhow::Result<Exit> {
    let results = runs.iter().map(|run| Results::open(run)).collect::<Result<Vec<_>, _>>();
    let results = results.map_err(|e| Exit::Input.because(e))?;
    results.iter().flat_map(Results::remarks).for_each(crate::cli::note);
    let report = Report::gather(results, pools).map_err(|e| Exit::Input.because(e))?;
    let first = runs.first().map(PathBuf::as_path).unwrap_or(Path::new("."));
    let folder = out.map_or_else(|| first.join("report"), Path::to_path_buf);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let tables: Vec<Vec<Table>> = report.sections.iter().map(report::tables).collect();
    let overview = report::overview(&report);
    let all: Vec<Table> = overview.iter().chain(tables.iter().flatten()).cloned().collect();
    let pictures = report
        .sections
        .iter()
        .map(|section| report::thumbnails(section, thumbnails))
        .collect::<Result<Vec<_>, _>>()
        .context("cannot make pictures of failures")?;
    let page = report::page(&Page {
        report: &report,
        build: env!("WAD_COSIM_VERSION"),
        pictures: &pictures,
        folder: &folder,
    });
    let text = page_of_markdown(&report, overview.as_slice(), &tables);
    let mut files =
        vec![("index.html", page), ("report.csv", report::csv(&all)), ("report.tex", report::latex(&all))];
    files.push(("report.md", text.clone()));
    let mut written = Vec::new();
    for (name, text) in files {
        let path = folder.join(name);
        write(&path, &text)?;
        written.push(path);
    }
    if let Some(path) = markdown {
        write(path, &text)?;
        written.push(path.to_path_buf());
    }
    if json {
        let pictures: usize = pictures.iter().map(Vec::len).sum();
        print(&format!(
            "{}\n",
            serde_json::json!({ "files": written, "tables": all.len(), "pictures": pictures })
        ))?;
    } else {
        print(&written.iter().map(|path| format!("{}\n", path.display())).collect::<String>())?;
    }
    Ok(Exit::Done)
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text)
        .map_err(|e| Exit::Other.because(e))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// The tables as a Markdown page, with the runs that they come from.
fn page_of_markdown(report: &Report, overview: &[Table], tables: &[Vec<Table>]) -> String {
    let mut text = String::from(
        "# Results\n\n`wad-cosim report` wrote the tables of this page; [evaluate.md](evaluate.md) says how to measure them \
         again. Each success rate has its standard deviation over weathers and seeds and Wilson's 95 % interval.\n\n",
    );
    text += &detectors(report);
    text += &makings(report);
    text += &report::markdown(overview);
    for (section, tables) in report.sections.iter().zip(tables) {
        text += &format!("## {}\n\n", section.suite.title);
        for (path, manifest) in &section.runs {
            let agents: Vec<String> =
                manifest.agents.iter().map(|(name, id)| format!("; {name}: {id}")).collect();
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            text += &format!(
                "- run `{name}`: wad-cosim {}, SUMO {}, detector {}{}\n",
                manifest.build,
                manifest.sumo,
                manifest.options.sight_name(),
                agents.join("")
            );
        }
        text.push('\n');
        text += &report::markdown(tables);
    }
    text
}

/// The paragraph that names the detectors of the runs.
fn detectors(report: &Report) -> String {
    let manifests = || report.sections.iter().flat_map(|section| &section.runs).map(|(_, manifest)| manifest);
    let named = |options: &EnvOptions| {
        let mirrors = if options.mirrors { " --mirrors" } else { "" };
        let what = if options.detector == "truth" { ", the renderer's own boxes" } else { "" };
        format!("`--detector {}{mirrors}`{what}", options.detector)
    };
    let names: BTreeSet<String> = manifests().map(|manifest| named(&manifest.options)).collect();
    let text = match names.first() {
        None => return String::new(),
        Some(name) if names.len() == 1 => {
            format!("every figure of ours on this page was driven with {name}.")
        }
        Some(_) => {
            let all: Vec<String> = names.into_iter().collect();
            format!(
                "the runs of this page were driven with {}; tables with several name each agent's.",
                all.join("; ")
            )
        }
    };
    format!("**Detector:** {text}\n\n")
}

/// The paragraph on how the agents of the runs were made, as far as their files say; and which are blind.
fn makings(report: &Report) -> String {
    let ids: BTreeMap<&String, &String> =
        report.sections.iter().flat_map(|s| &s.runs).flat_map(|(_, manifest)| &manifest.agents).collect();
    let mut agents: Vec<String> = Vec::new();
    for agent in report.sections.iter().flat_map(|section| section.agents()) {
        if !agents.contains(&agent) {
            agents.push(agent);
        }
    }
    let (mut demonstrated, mut alone, mut blind) = (Vec::new(), Vec::new(), Vec::new());
    for agent in &agents {
        let name = format!("`{}`", report::short(agent));
        match ids.get(agent).and_then(|id| agents::is_demonstrated(agent, id)) {
            Some(true) => demonstrated.push(name),
            Some(false) => alone.push(name),
            None if agent == "autopilot" => blind.push("the autopilot".to_string()),
            None if agent.parse::<DriverSpec>().is_ok_and(|spec| !spec.looks()) => blind.push(name),
            None => {}
        }
    }
    let sentence = |names: &[String], one: &str, more: &str| match names {
        [] => String::new(),
        [name] => format!(" {name} {one}"),
        [first @ .., last] => format!(" {} and {last} {more}", first.join(", ")),
    };
    let with = "made with demonstrations: imitation of the autopilot plus reinforcement \
                ([agents.md](agents.md#the-shipped-agents)).";
    let text = sentence(&demonstrated, &format!("was {with}"), &format!("were {with}"))
        + &sentence(&alone, "was made by reinforcement alone.", "were made by reinforcement alone.")
        + &sentence(&blind, "is blind: it ignores the camera.", "are blind: they ignore the camera.")
            .replacen(" the autopilot", " The autopilot", 1);
    if text.is_empty() { text } else { format!("**Agents:**{text}\n\n") }
}
