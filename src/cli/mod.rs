//! The command line: one file per command. Here: what all commands share, which is
//! exit codes, log level and printing.

// `println` and `eprintln` panic where nothing can be written: `print`, `row` and `note` do not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod agents;
mod bench;
mod bench_camera;
mod bench_fleet;
mod bench_tick;
#[cfg(feature = "learn")]
mod bench_train;
mod bench_view;
mod config;
mod dataset;
mod doctor;
mod eval;
mod exit;
mod film;
mod net;
#[cfg(all(test, feature = "learn"))]
mod pages;
mod progress;
mod replay;
mod replay_look;
mod replay_view;
mod report;
mod run;
mod scenario;
mod shell;
mod snapshot;
mod train;
mod view;

use anyhow::Context;
use clap::{ArgAction, CommandFactory, Parser, Subcommand};
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;
use wad_cosim::interrupt::Interrupt;

pub use exit::Exit;

/// Place of the options that all commands have in a help: behind the command's own, before --help.
const LAST: usize = 900;

/// Drive an ego vehicle with real physics through SUMO traffic.
#[derive(Parser)]
#[command(name = "wad-cosim", version = env!("WAD_COSIM_VERSION"), max_term_width = 100)]
#[command(after_help = "Exit codes: 0 done; 2 usage or input; 3 SUMO failed; \
                        4 interrupted, results kept; 1 anything else.")]
struct Cli {
    #[command(flatten)]
    common: Common,
    #[command(subcommand)]
    command: Command,
}

/// The options of all commands.
#[derive(clap::Args, Clone, Copy, Debug, Default, PartialEq)]
pub struct Common {
    /// Print more on stderr: -v progress, -vv details, -vvv everything.
    #[arg(short, long, global = true, action = ArgAction::Count, display_order = LAST)]
    verbose: u8,
    /// Print only errors on stderr.
    #[arg(short, long, global = true, conflicts_with = "verbose", display_order = LAST)]
    quiet: bool,
}

impl Cli {
    /// The options of all commands, those behind a suite's file too.
    fn common(&self) -> Common {
        let behind = match &self.command {
            Command::Eval(args) => args.behind_file(),
            _ => Common::default(),
        };
        Common {
            verbose: self.common.verbose.saturating_add(behind.verbose),
            quiet: self.common.quiet || behind.quiet,
        }
    }
}

#[derive(Subcommand)]
enum Command {
    /// Drive an ego vehicle through SUMO traffic, by autopilot, agent or hand.
    Run(Box<run::Args>),
    /// Drive through a town under the autopilot and save a picture.
    Snapshot(Box<snapshot::Args>),
    /// Collect training data while the autopilot drives.
    Dataset(Box<dataset::Args>),
    /// Train a network.
    Train(train::Args),
    /// Measure speed, as a ratio to SUMO alone in the same run.
    Bench(bench::Args),
    /// Drive the episodes of a suite, or score a part of the system against the ground truth.
    Eval(eval::Args),
    /// Show a kept episode again, as a film or in sumo-gui, or simulate it again and compare every bit.
    Replay(replay::Args),
    /// Make pictures and tables of trainings and evaluations.
    Report(report::Args),
    /// Make, edit, check, list and drive scenarios: folders of SUMO files for netedit.
    Scenario(Box<scenario::Args>),
    /// Inspect, build, import and enrich nets.
    Net(Box<net::Args>),
    /// Check this machine for everything that wad-cosim needs, and say how to install what is missing.
    Doctor(doctor::Args),
    /// Print a script that completes commands and options in a shell.
    Completions(shell::Completions),
    /// Write the manual pages, one for each command.
    Man(shell::Man),
}

/// Parse the command line, run the command, and turn its result into an exit code.
pub fn main() -> ExitCode {
    wad_cosim::register_bundled();
    let cli = Cli::parse();
    start_log(cli.common());
    if let Err(wrong) = wad_cosim::camera::Instructions::allowed() {
        note(format_args!("wad-cosim: {wrong}"));
        return Exit::Input.into();
    }
    let result = match cli.command {
        Command::Run(args) => run::run(*args),
        Command::Snapshot(args) => snapshot::run(*args),
        Command::Dataset(args) => dataset::run(*args),
        Command::Train(args) => train::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Replay(args) => replay::run(&args),
        Command::Report(args) => report::run(args),
        Command::Scenario(args) => scenario::run(*args),
        Command::Net(args) => net::run(*args),
        Command::Doctor(args) => doctor::run(args),
        Command::Completions(args) => shell::completions(&args, &mut Cli::command()),
        Command::Man(args) => shell::man(&args, Cli::command()),
    };
    match result {
        Ok(exit) => exit.into(),
        Err(error) => {
            note(format_args!("wad-cosim: {}", message(&error)));
            Exit::of(&error).into()
        }
    }
}

/// The error and its causes in one text; a cause that the text already quotes is not repeated.
fn message(error: &anyhow::Error) -> String {
    error
        .chain()
        .map(ToString::to_string)
        .reduce(|text, cause| if text.contains(&cause) { text } else { format!("{text}: {cause}") })
        .unwrap_or_default()
}

/// Log to stderr: stdout belongs to results. `WAD_COSIM_LOG` (a tracing filter such as
/// `wad_cosim::traci=trace`) wins over `-v` and `-q`.
fn start_log(Common { verbose, quiet }: Common) {
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (_, 0) => "warn",
        (_, 1) => "info",
        (_, 2) => "debug",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_env("WAD_COSIM_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // It would say on stderr that stderr cannot be written, and panic.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(verbose > 1)
        .without_time()
        .init();
}

/// The asynchronous runtime, on this thread.
pub fn runtime() -> anyhow::Result<tokio::runtime::Runtime> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.context("cannot start the asynchronous runtime")
}

/// A number of seconds that an option gives: a year at most.
fn seconds(text: &str) -> Result<f64, String> {
    const YEAR: f64 = 366.0 * 86_400.0;
    let value = text.parse().ok().filter(|value| (0.0..=YEAR).contains(value));
    value.ok_or_else(|| format!("expected seconds from 0 to {YEAR:.0}, found `{text}`"))
}

/// Ctrl-C and SIGTERM from now on.
fn interrupt() -> anyhow::Result<Interrupt> {
    Interrupt::listen().context("cannot listen for Ctrl-C")
}

/// A command's answer: `text`, or with `json` the text on stderr and `value` as the last line of stdout.
pub fn answer(text: &str, json: bool, value: &impl serde::Serialize) -> anyhow::Result<()> {
    if !json {
        return print(text);
    }
    note(text.trim_end());
    print(&(serde_json::to_string(value)? + "\n"))
}

/// Write a line to stderr. One that cannot be written (a full disk) is lost, the command goes on.
pub fn note(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Write a line of a table that grows while a command works: to stdout, or with `json` to stderr.
pub fn row(line: &str, json: bool) -> anyhow::Result<()> {
    if json {
        note(line);
        return Ok(());
    }
    print(&format!("{line}\n"))
}

/// Writes `text` to a file that the user asked for; where it cannot be written that is bad input.
pub fn save(path: &std::path::Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text)
        .map_err(|e| Exit::Input.because(e))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Write `text` to stdout. A closed pipe (`| head`) is not an error.
pub fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(anyhow::Error::new(error).context("cannot write to standard output"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_that_no_clock_holds_are_refused() {
        for text in ["nan", "inf", "1e300", "-1", "1e8", "soon"] {
            assert!(seconds(text).unwrap_err().contains(text), "{text}");
        }
        assert_eq!((seconds("0"), seconds("60.5")), (Ok(0.0), Ok(60.5)));
        let run =
            |option: &str, value: &str| Cli::try_parse_from(["wad-cosim", "run", "town5", option, value]);
        let eval = |value| Cli::try_parse_from(["wad-cosim", "eval", "nocrash", "--agent-timeout", value]);
        assert!(eval("1e300").is_err() && eval("5").is_ok());
        for option in ["--tick-timeout", "--time"] {
            assert!(run(option, "nan").is_err() && run(option, "1e300").is_err() && run(option, "5").is_ok());
        }
    }

    #[test]
    fn every_command_with_json_has_its_section_in_the_page_of_json() {
        fn collect(command: &clap::Command, name: &str, found: &mut Vec<String>) {
            for below in command.get_subcommands() {
                collect(below, format!("{name} {}", below.get_name()).trim(), found);
            }
            if command.get_arguments().any(|argument| argument.get_long() == Some("json")) {
                found.push(name.to_string());
            }
        }
        let page = include_str!("../../docs/json.md");
        let mut commands = Vec::new();
        collect(&Cli::command(), "", &mut commands);
        assert!(commands.len() > 15, "{commands:?}");
        // The suites print what `eval` does.
        let suites: Vec<String> =
            wad_cosim::eval::names().iter().map(|name| format!("eval {name}")).collect();
        commands.retain(|command| !suites.contains(command));
        for command in commands {
            assert!(page.contains(&format!("`{command}`")), "docs/json.md lacks `{command}`");
        }
    }

    #[test]
    fn every_command_shows_an_example_in_its_help() {
        fn look(command: &clap::Command, name: &str) {
            let mut leaf = true;
            for below in command.get_subcommands().filter(|below| below.get_name() != "help") {
                leaf = false;
                look(below, &format!("{name} {}", below.get_name()));
            }
            let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(!leaf || after.contains("Example"), "{name}: no example");
        }
        look(&Cli::command(), "wad-cosim");
    }

    #[test]
    fn a_suite_from_a_file_takes_the_options_of_all_commands() {
        let common = |words: &str| Cli::try_parse_from(words.split(' ')).unwrap().common();
        for (words, verbose, quiet) in [
            ("wad-cosim eval nocrash --agent constant -v", 1, false),
            ("wad-cosim eval mine.json --agent constant -v", 1, false),
            ("wad-cosim -v eval mine.json -vv --jobs 2", 3, false),
            ("wad-cosim eval mine.json --quiet", 0, true),
        ] {
            assert_eq!(common(words), Common { verbose, quiet }, "{words}");
        }
    }

    #[test]
    fn an_option_without_effect_is_refused() {
        let parse = |words: &str| Cli::try_parse_from(words.split(' ')).map(drop);
        for words in [
            "replay a --view --record film.mp4",
            "replay a --view --detector truth",
            "replay a --view --verify",
            "replay a --view --gui",
            "replay a --view --json",
            "replay a --last 5",
            "replay a --verify --last 5",
            "eval nocrash --keep all",
            "eval nocrash --keep failures",
            "eval nocrash --shard 1/4",
            "eval lead --weather ClearNoon,WetNoon",
            "eval lanes --near",
        ] {
            let refused = parse(&format!("wad-cosim {words}"));
            assert!(refused.is_err_and(|error| error.exit_code() == 2), "{words}");
        }
        for words in [
            "replay a --view --view-speed 2",
            "replay a --record film.mp4 --last 5 --verify --json",
            "replay a --detector truth --last 5",
            "replay a --record film.mp4 --detector truth --last 5",
            "eval nocrash --keep none",
            "eval nocrash --keep all --shard 1/4 --out a",
            "eval nocrash --out a",
            "eval lead --weather WetNoon --near",
            "eval lanes --weather ClearNoon,WetNoon",
        ] {
            assert!(parse(&format!("wad-cosim {words}")).is_ok(), "{words}");
        }
    }

    #[test]
    fn the_options_of_all_commands_come_last_in_a_help() {
        let mut program = Cli::command();
        program.build();
        for command in program.get_subcommands_mut().filter(|command| command.get_name() != "help") {
            let help = command.render_long_help().to_string();
            let own = help.rfind("--verbose").expect("a common option");
            let after = help[own..].matches("\n      --").count();
            assert!(after == 0, "{}: {help}", command.get_name());
        }
    }
}
