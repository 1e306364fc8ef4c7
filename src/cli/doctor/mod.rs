//! `doctor`: checks the machine, and says how to install what is missing.

mod libraries;
mod machine;
mod sumo;

use super::{Exit, print};
use serde::Serialize;
use std::fmt::Write;

#[derive(clap::Args)]
#[command(after_help = "Example:\n  wad-cosim doctor --json")]
pub struct Args {
    /// Print one JSON object instead of the table.
    #[arg(long)]
    json: bool,
}

/// What one check found.
#[derive(Debug, Serialize)]
struct Finding {
    name: &'static str,
    status: Status,
    /// One line: what there is, with version and place.
    found: String,
    /// How to fix it, if there is something to fix.
    #[serde(skip_serializing_if = "Option::is_none")]
    advice: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Status {
    Ok,
    /// Missing or not built in; the rest works without it.
    Optional,
    /// Needed, and missing or broken.
    Missing,
}

impl Finding {
    fn ok(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, status: Status::Ok, found: found.into(), advice: None }
    }

    fn optional(name: &'static str, found: impl Into<String>) -> Self {
        Self { status: Status::Optional, ..Self::ok(name, found) }
    }

    fn missing(name: &'static str, found: impl Into<String>) -> Self {
        Self { status: Status::Missing, ..Self::ok(name, found) }
    }

    fn advice(self, advice: impl Into<String>) -> Self {
        Self { advice: Some(advice.into()), ..self }
    }
}

#[derive(Serialize)]
struct Report {
    version: &'static str,
    /// Whether nothing needed is missing.
    ok: bool,
    checks: Vec<Finding>,
}

/// Check and print; [`Exit::Done`] if nothing needed is missing.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    let checks = vec![
        sumo::sumo(),
        sumo::tools(),
        libraries::libtorch(),
        libraries::openvino(),
        libraries::opencv(),
        machine::gpu(),
        machine::cores(),
        machine::memory(),
        machine::cache(),
        machine::towns(),
    ];
    let ok = checks.iter().all(|finding| finding.status != Status::Missing);
    let report = Report { version: env!("WAD_COSIM_VERSION"), ok, checks };
    print(&if args.json { serde_json::to_string(&report)? + "\n" } else { table(&report) })?;
    Ok(if ok { Exit::Done } else { Exit::Other })
}

fn table(report: &Report) -> String {
    let mut text = format!("wad-cosim {}\n", report.version);
    for Finding { name, status, found, advice } in &report.checks {
        let mark = match status {
            Status::Ok => "ok",
            Status::Optional => "-",
            Status::Missing => "MISSING",
        };
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{mark:<8}{name:<10}{found}");
        if let Some(advice) = advice {
            let _ = writeln!(text, "{:18}-> {advice}", "");
        }
    }
    text.push_str(if report.ok {
        "Everything needed is here.\n"
    } else {
        "Something needed is missing: see MISSING above.\n"
    });
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_names_what_is_missing_and_the_remedy() {
        let report = Report {
            version: "1",
            ok: false,
            checks: vec![
                Finding::ok("cores", "2"),
                Finding::missing("SUMO", "not found").advice("run scripts/setup"),
            ],
        };
        let text = table(&report);
        assert!(text.contains("\nok      cores     2\n"), "{text}");
        assert!(
            text.contains("\nMISSING SUMO      not found\n                  -> run scripts/setup\n"),
            "{text}"
        );
        assert!(text.ends_with("see MISSING above.\n"), "{text}");
    }
}
