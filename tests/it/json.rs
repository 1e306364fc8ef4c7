//! docs/json.md names the keys that `--json` really prints, with their types.

use super::program::{json, stderr, wad};
use serde_json::Value;
use std::collections::BTreeMap;

/// Keys and types that the page gives to a command.
fn documented(page: &str, command: &str) -> BTreeMap<String, String> {
    let title = format!("## `{command}`\n");
    let section = page.split(&title).nth(1).unwrap_or_else(|| panic!("no section {command}"));
    let section = section.split("\n## ").next().unwrap_or_default();
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        (cells[1].trim_matches('`').to_string(), cells[2].to_string())
    })
    .collect()
}

fn is_of(value: &Value, kind: &str) -> bool {
    match kind {
        _ if kind.ends_with('?') => value.is_null() || is_of(value, &kind[..kind.len() - 1]),
        "text" => value.is_string(),
        "whole" => value.is_u64(),
        "number" => value.is_number(),
        "yes/no" => value.is_boolean(),
        "list" => value.is_array(),
        "object" => value.is_object(),
        _ => panic!("the page has a type `{kind}`"),
    }
}

#[test]
fn the_page_of_json_says_what_is_printed() {
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/json.md")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let suite = r#"{"name": "small", "title": "Small", "episodes": 1,
        "conditions": [{"name": "wet", "town": "town3", "weathers": ["WetNoon"]}],
        "tasks": [{"name": "busy", "kind": "composite", "traffic": "6,6", "tick_limit": 30}]}"#;
    std::fs::write(path("small.json"), suite).unwrap();
    // A section's keys and what was printed.
    let compare = |section: &str, answer: &Value| {
        let documented = documented(&page, section);
        for (key, kind) in &documented {
            let found = match answer.get(key) {
                Some(found) => found,
                None if kind.ends_with('?') => continue,
                None => panic!("{section} has no `{key}`: {answer}"),
            };
            assert!(is_of(found, kind), "{section}: `{key}` is no {kind}: {found}");
        }
        for key in answer.as_object().unwrap().keys() {
            assert!(documented.contains_key(key), "{section}: docs/json.md lacks `{key}`");
        }
    };
    let check = |command: &str, args: &[&str]| {
        let words: Vec<&str> = command.split(' ').chain(args.iter().copied()).chain(["--json"]).collect();
        // A page's section stands for the commands that print the same.
        let command = match command {
            "eval eyes" => "eval detector",
            "net import" => "net build",
            "train eyes" => "train detector",
            _ => command,
        };
        let output = wad(&words).output().unwrap();
        assert!(output.status.success(), "{command}: {}", stderr(&output));
        let answer = json(&output);
        compare(command, &answer);
        answer
    };
    check("run", &["town5", "--ticks", "5", "--traffic", "2,2", "--out", &path("run")]);
    let agent = ["--agent", "constant:1,0.4,0", "--keep", "all"];
    check("eval", &[&[&path("small.json"), "--out", &path("eval")], &agent[..]].concat());
    check("eval merge", &[&path("eval"), "--out", &path("merged")]);
    check("report", &[&path("eval")]);
    let kept = std::fs::read_dir(path("eval/episodes")).unwrap().next().unwrap().unwrap().path();
    check("replay", &[&kept.display().to_string(), "--verify", "--detector", "truth"]);
    check(
        "eval routes",
        &["town5", "--set", "straight", "--count", "1", "--out", &path("town5.routes.json")],
    );
    for command in ["eval lanes", "eval lead"] {
        check(command, &["--ticks", "20", "--weather", "ClearNoon", "--traffic", "6,6"]);
    }
    for command in ["eval detector", "eval eyes"] {
        let both = ["--detector", "truth", "--detector", "truth:faulty"];
        let answer = check(command, &[&both[..], &["--frames", "1", "--weather", "ClearNoon"]].concat());
        let names: Vec<&Value> =
            answer["detectors"].as_array().unwrap().iter().map(|one| &one["detector"]).collect();
        assert_eq!(names, ["truth", "truth:faulty"]);
        for one in answer["detectors"].as_array().unwrap() {
            compare("detectors", one);
        }
    }
    check("scenario check", &["cross"]);
    check("scenario list", &[]);
    check("run", &["cross", "--ticks", "5", "--out", &path("cross")]);
    check("run", &["town5", "--egos", "2", "--ticks", "5", "--traffic", "2,2", "--out", &path("egos")]);
    check(
        "dataset collect",
        &["--town", "town3", "--frames", "24", "--per-shard", "12", "--camera", "--out", &path("data")],
    );
    check("net info", &["town5"]);
    let net = wad_cosim::bundled::resolve("town5.net.xml").unwrap().display().to_string();
    check("net import", &[&net, "--out", &path("net")]);
    check("net enrich", &[&net, "--crossings", "--out", &path("more.net.xml")]);
    check("bench bridge", &["--populations", "2/2", "--ticks", "2", "--repeat", "1"]);
    check(
        "bench camera",
        &["--frames", "1", "--weather", "ClearNoon", "--sizes", "64x64", "--town-times", "1"],
    );
    check("bench fleet", &["--egos", "2", "--traffic", "2,2", "--seconds", "0.1"]);
    check("bench tick", &["--ticks", "1", "--warm-up", "1"]);
    let view = check("bench view", &["--repeat", "1", "--ticks", "2", "--viewers", "2"]);
    assert_eq!(view["rows"].as_array().map(Vec::len), Some(3), "one turn is measured: {view}");
    check("doctor", &[]);
    if cfg!(feature = "learn") {
        let data = path("data");
        check(
            "train encoder",
            &["--data", &data, "--epochs", "1", "--epoch-steps", "1", "--out", &path("encoder")],
        );
        let encoder = path("encoder");
        check(
            "eval encoder",
            &["--encoder", &encoder, "--data", &data, "--probe-data", &data, "--frames", "4"],
        );
        for command in ["train detector", "train eyes"] {
            let steps =
                ["--epochs", "1", "--epoch-steps", "1", "--window", "128x128", "--validation-frames", "2"];
            check(command, &[&["--data", &data, "--out", &path(command)], &steps[..]].concat());
        }
        check("train agent", &["--algo", "td3", "--inputs", "raw", "--steps", "0", "--out", &path("agent")]);
        check(
            "bench train",
            &["--task", "straight", "--inputs", "raw", "--collectors", "1", "--seconds", "0"],
        );
    }
}
