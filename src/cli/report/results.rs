//! `wad-cosim report RUN...`: the results of evaluations.

use crate::cli::{Exit, print};
use anyhow::Context;
use std::path::{Path, PathBuf};
use wad_cosim::eval::Results;
use wad_cosim::eval::report::{self, Page, Report, Table};

/// Writes the report of `runs` into the folder `out`: `index.html`, `report.md`, `report.csv`, `report.tex`;
/// with `markdown` the Markdown there too.
pub fn run(
    runs: &[PathBuf],
    out: Option<&Path>,
    markdown: Option<&Path>,
    thumbnails: usize,
    json: bool,
) -> anyhow::Result<Exit> {
    let results = runs.iter().map(|run| Results::open(run)).collect::<Result<Vec<_>, _>>();
    let results = results.map_err(|e| Exit::Input.because(e))?;
    results.iter().flat_map(Results::remarks).for_each(|remark| eprintln!("{remark}"));
    let report = Report::gather(results).map_err(|e| Exit::Input.because(e))?;
    let first = runs.first().map(PathBuf::as_path).unwrap_or(Path::new("."));
    let folder = out.map_or_else(|| first.join("report"), Path::to_path_buf);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let tables: Vec<Vec<Table>> = report.sections.iter().map(report::tables).collect();
    let all: Vec<Table> = tables.iter().flatten().cloned().collect();
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
    let text = page_of_markdown(&report, &tables);
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
fn page_of_markdown(report: &Report, tables: &[Vec<Table>]) -> String {
    let mut text = String::from(
        "# Results\n\n`wad-cosim report` wrote the tables of this page; [evaluate.md](evaluate.md) says how to measure them \
         again. Each success rate has its standard deviation over weathers and seeds and Wilson's 95 % interval.\n\n",
    );
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
                manifest.options.detector,
                agents.join("")
            );
        }
        text.push('\n');
        text += &report::markdown(tables);
    }
    text
}
