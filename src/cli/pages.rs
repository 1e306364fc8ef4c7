//! The command lines that the pages and the helps show: each is parsed as the program parses its own.

use super::Cli;
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A part of a page without blank lines.
#[derive(Debug, PartialEq)]
struct Part {
    /// Number of its first line.
    line: usize,
    /// Of a block that is fenced or indented by four spaces; else prose, or a row of a table.
    is_code: bool,
    text: String,
}

fn parts(page: &str) -> Vec<Part> {
    let mut parts: Vec<Part> = Vec::new();
    let (mut is_fenced, mut before) = (false, None);
    for (index, line) in page.lines().enumerate() {
        if line.starts_with("```") {
            (is_fenced, before) = (!is_fenced, None);
            continue;
        }
        let is_code = is_fenced || line.starts_with("    ");
        let kind = (!line.trim().is_empty()).then_some(is_code);
        match parts.last_mut() {
            Some(part) if kind.is_some() && kind == before && !line.starts_with('|') => {
                part.text.push('\n');
                part.text.push_str(line);
            }
            _ if kind.is_some() => parts.push(Part { line: index + 1, is_code, text: line.to_string() }),
            _ => {}
        }
        before = kind;
    }
    parts
}

/// The commands of a shell's line as words, without comment and redirections. `$(...)` stays as it is.
fn split(line: &str) -> Vec<Vec<String>> {
    let mut commands: Vec<Vec<String>> = vec![Vec::new()];
    let mut word: Option<String> = None;
    let (mut quote, mut depth, mut is_redirected) = (None, 0, false);
    for c in line.chars().chain(['\n']) {
        if quote == Some(c) {
            quote = None;
        } else if quote.is_some() {
            word.get_or_insert_default().push(c);
        } else if matches!(c, '\'' | '"') {
            quote = Some(c);
            word.get_or_insert_default();
        } else if depth > 0 || c == '(' || !(c.is_whitespace() || "#;|&<>".contains(c)) {
            depth = (depth + i32::from(c == '(') - i32::from(c == ')')).max(0);
            word.get_or_insert_default().push(c);
        } else if c == '#' && word.is_some() {
            word.get_or_insert_default().push(c);
        } else {
            if let Some(word) = word.take() {
                if !is_redirected && let Some(command) = commands.last_mut() {
                    command.push(word);
                }
                is_redirected = false;
            }
            match c {
                '#' => break,
                '<' | '>' => is_redirected = true,
                ';' | '|' | '&' => commands.push(Vec::new()),
                _ => {}
            }
        }
    }
    commands.retain(|command| !command.is_empty());
    commands
}

/// `NAME=VALUE`.
fn assignment(word: &str) -> Option<(&str, &str)> {
    let (name, value) = word.split_once('=')?;
    let is_name = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    is_name.then_some((name, value))
}

/// The commands of a block, with the values of the variables that it sets; of a `for` the first value.
fn commands(block: &str) -> Vec<Vec<String>> {
    let mut variables: BTreeMap<String, String> = BTreeMap::new();
    let mut commands = Vec::new();
    for command in block.replace("\\\n", " ").lines().flat_map(split) {
        let mut words: Vec<String> = Vec::new();
        for word in command {
            // The longest of names that begin alike comes first.
            let text = variables
                .iter()
                .rev()
                .fold(word.clone(), |text, (name, value)| text.replace(&format!("${name}"), value));
            if word.starts_with('$') {
                words.extend(text.split_whitespace().map(str::to_string));
            } else {
                words.push(text);
            }
        }
        match words.as_slice() {
            [first, name, _, value, ..] if first == "for" => {
                variables.insert(name.clone(), value.clone());
            }
            [only] if assignment(only).is_some() => {
                variables.extend(assignment(only).map(|(name, value)| (name.to_string(), value.to_string())));
            }
            _ => commands.push(words),
        }
    }
    commands
}

/// The words behind `wad-cosim`, if that is a command's program.
fn arguments(command: &[String]) -> Option<&[String]> {
    let is_before =
        |word: &String| ["$", "do", "then", "time"].contains(&word.as_str()) || assignment(word).is_some();
    let program = command.iter().position(|word| !is_before(word))?;
    // `wad-cosim = {...}` is a line of a Cargo.toml.
    let is_ours = command[program].rsplit('/').next() == Some("wad-cosim")
        && command.get(program + 1).is_none_or(|word| word != "=");
    is_ours.then(|| &command[program + 1..])
}

/// A word in capitals, such as `FILE`, `N` or `K/N`, which stands for another.
fn is_placeholder(word: &str) -> bool {
    word.contains(|c: char| c.is_ascii_uppercase()) && !word.contains(|c: char| c.is_ascii_lowercase())
}

/// The names of the commands below that of `path`, with the built-in `help`.
fn names(path: &[&str]) -> Vec<String> {
    let program = Cli::command();
    let below = path.iter().try_fold(&program, |command, name| command.find_subcommand(name));
    let names = below.into_iter().flat_map(clap::Command::get_subcommands);
    names.map(|command| command.get_name().to_string()).chain(["help".to_string()]).collect()
}

/// Parses the words behind `wad-cosim`. Those behind `eval FILE` and `eval SCENARIO` are parsed as a suite's; `page` may say
/// how to make the scenario.
fn parse(words: &[String], page: &str) -> Result<(), clap::Error> {
    let mut line: Vec<&str> = vec!["wad-cosim"];
    line.extend(words.iter().map(String::as_str));
    if let ["eval", suite, ..] = line[1..]
        && !suite.starts_with('-')
        && !names(&["eval"]).iter().any(|name| name == suite)
    {
        let is_there = suite.ends_with(".json")
            || is_placeholder(suite)
            || wad_cosim::bundled::scenarios().iter().any(|scenario| scenario == suite)
            || page.contains(&format!("scenario new {suite} "));
        if !is_there {
            return Err(clap::Error::raw(ErrorKind::InvalidSubcommand, format!("no suite `{suite}`")));
        }
        line[2] = "nocrash";
    }
    match Cli::try_parse_from(line) {
        Err(error) if error.exit_code() != 0 => Err(error),
        _ => Ok(()),
    }
}

/// The commands of a page, and what is wrong with some.
#[derive(Default)]
struct Found {
    commands: usize,
    mentions: usize,
    wrong: Vec<String>,
}

impl Found {
    fn note(&mut self, place: &str, words: &[String], error: &clap::Error) {
        let text = error.to_string();
        self.wrong.push(format!(
            "{place}: {}\n    {}",
            words.join(" "),
            text.lines().next().unwrap_or_default()
        ));
    }

    /// A whole command line.
    fn command(&mut self, place: &str, words: &[String], page: &str) {
        self.commands += 1;
        if let Err(error) = parse(words, page) {
            self.note(place, words, &error);
        }
    }

    /// A command in a sentence, with or without `wad-cosim`. It may leave out what a command needs, and values.
    fn mention(&mut self, place: &str, span: &str, page: &str) {
        let Some(command) = split(span).into_iter().next().filter(|_| !span.contains('[')) else { return };
        let ours = arguments(&command);
        let mut words = ours.unwrap_or(&command).to_vec();
        let Some(first) = words.first() else { return };
        if !names(&[]).contains(first) && (ours.is_none() || is_placeholder(first)) {
            return;
        }
        self.mentions += 1;
        // `eval --jobs` means `eval SUITE --jobs`.
        if first == "eval" && words.get(1).is_some_and(|word| word.starts_with("--")) {
            words.insert(1, "SUITE".to_string());
        }
        let Err(error) = parse(&words, page) else { return };
        let is_fine = match error.kind() {
            ErrorKind::MissingRequiredArgument
            | ErrorKind::MissingSubcommand
            | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => true,
            ErrorKind::InvalidValue => words.last().is_some_and(|word| word.starts_with("--")),
            ErrorKind::ValueValidation => words.iter().any(|word| is_placeholder(word)),
            _ => false,
        };
        if !is_fine {
            self.note(place, &words, &error);
        }
    }

    fn page(&mut self, name: &str, page: &str) {
        for part in parts(page) {
            let place = format!("{name}:{}", part.line);
            if part.is_code {
                for command in commands(&part.text) {
                    if let Some(words) = arguments(&command) {
                        self.command(&place, words, page);
                    }
                }
            } else {
                for span in part.text.replace('\n', " ").split('`').skip(1).step_by(2) {
                    self.mention(&place, span, page);
                }
            }
        }
    }

    /// The examples in the help of `command` and of those below it.
    fn help(&mut self, command: &clap::Command, name: &str) {
        for below in command.get_subcommands() {
            self.help(below, &format!("{name} {}", below.get_name()));
        }
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let help = help.split("\\\n").map(|part| part.trim_matches(' ')).collect::<Vec<_>>().join(" ");
        for line in help.lines().map(str::trim) {
            // What an example is for stands behind two spaces.
            for command in split(line.split("  ").next().unwrap_or_default()) {
                if let Some(words) = arguments(&command) {
                    self.command(&format!("{name} --help"), words, &help);
                }
            }
        }
    }
}

fn entries(folder: PathBuf) -> impl Iterator<Item = PathBuf> {
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// All pages but the changelog and the histories, whose commands are those of their day.
fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folders = ["", "docs", "python", "sumo_nets"].map(|name| root.join(name)).into_iter();
    let folders = folders.chain(entries(root.join("models"))).chain(entries(root.join("crates")));
    let mut pages: Vec<PathBuf> = folders
        .flat_map(entries)
        .filter(|file| file.extension().is_some_and(|e| e == "md"))
        .filter(|file| !file.ends_with("CHANGELOG.md") && !file.ends_with("HISTORY.md"))
        .collect();
    pages.sort();
    pages
}

#[test]
fn every_command_on_a_page_parses() {
    wad_cosim::register_bundled();
    let mut found = Found::default();
    for file in pages() {
        let page = std::fs::read_to_string(&file).unwrap();
        let name = file.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap_or(&file);
        found.page(&name.display().to_string(), &page);
    }
    assert!(found.wrong.is_empty(), "commands that the program refuses:\n{}", found.wrong.join("\n"));
    assert!(found.commands > 120, "only {} commands", found.commands);
    assert!(found.mentions > 150, "only {} mentions", found.mentions);
}

#[test]
fn every_command_in_a_help_parses() {
    wad_cosim::register_bundled();
    let mut found = Found::default();
    found.help(&Cli::command(), "wad-cosim");
    assert!(found.wrong.is_empty(), "commands that the program refuses:\n{}", found.wrong.join("\n"));
    assert!(found.commands > 60, "only {} commands", found.commands);
}

#[test]
fn a_command_that_the_program_refuses_is_found_on_a_page() {
    wad_cosim::register_bundled();
    let wrong = |page: &str| {
        let mut found = Found::default();
        found.page("page", page);
        (found.commands, found.mentions, found.wrong.len())
    };
    for (page, expected) in [
        ("    wad-cosim run town5 --ticks 5   # the town's own\n", (1, 0, 0)),
        ("    wad-cosim run town5 --tick 5\n", (1, 0, 1)),
        ("```sh\n$ wad-cosim run town5 \\\n    --tick 5 | head\n```\n", (1, 0, 1)),
        ("    A=1 scripts/wad-cosim snapshot; wad-cosim run\n", (2, 0, 2)),
        ("    for n in 1 2; do\n        wad-cosim run town5 --seed $n --out a/$n > x\n    done\n", (1, 0, 0)),
        ("    own=\"--seed 1 --gui\"\n    wad-cosim run town5 $own\n", (1, 0, 0)),
        ("    wad-cosim run town5 --agent 'exec:python3 a.py --b' && wad-cosim doctor\n", (2, 0, 0)),
        ("    wad-cosim eval no_crash\n    wad-cosim eval mine.json --job 1\n", (2, 0, 2)),
        ("    wad-cosim eval mine.json --jobs 1\n    wad-cosim eval straight\n", (2, 0, 0)),
        ("    wad-cosim scenario new jam --seed 3\n    wad-cosim eval jam --jobs 2\n", (2, 0, 0)),
        ("    wad-cosim scenario new jam2 --seed 3\n    wad-cosim eval jam --jobs 2\n", (2, 0, 1)),
        ("    wad-cosim train agent --algo td3\n", (1, 0, 1)),
        ("A sentence with `wad-cosim run\n--tick 5`.\n", (0, 1, 1)),
        ("`train agent --egos`, `eval --shard K/N`, `run --record`, `wad-cosim COMMAND --help`", (0, 3, 0)),
        ("| `train agent --ego 3` | `eval nocrash --shards` |\n| `evaluate()` |\n", (0, 2, 2)),
        ("`wad-cosim fly`, `fly`, `run town5 --seed N`, `run town5 --seed n`", (0, 3, 2)),
    ] {
        assert_eq!(wrong(page), expected, "{page}");
    }
}
