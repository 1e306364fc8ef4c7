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
    let mut sections = 0;
    let mut check = |command: &str, args: &[&str]| {
        let words: Vec<&str> = command.split(' ').chain(args.iter().copied()).chain(["--json"]).collect();
        let output = wad(&words).output().unwrap();
        assert!(output.status.success(), "{command}: {}", stderr(&output));
        let answer = json(&output);
        let documented = documented(&page, command);
        for (key, kind) in &documented {
            let found = answer.get(key).unwrap_or_else(|| panic!("{command} has no `{key}`: {answer}"));
            assert!(is_of(found, kind), "{command}: `{key}` is no {kind}: {found}");
        }
        for key in answer.as_object().unwrap().keys() {
            assert!(documented.contains_key(key), "{command}: docs/json.md lacks `{key}`");
        }
        sections += 1;
    };
    check("run", &["town5", "--ticks", "5", "--traffic", "2,2", "--out", &path("run")]);
    let agent = ["--agent", "constant:1,0.4,0", "--keep", "all"];
    check("eval", &[&[&path("small.json"), "--out", &path("eval")], &agent[..]].concat());
    check("report", &[&path("eval")]);
    let kept = std::fs::read_dir(path("eval/episodes")).unwrap().next().unwrap().unwrap().path();
    check("replay --verify", &[&kept.display().to_string()]);
    check("scenario check", &["cross"]);
    check("scenario list", &[]);
    check(
        "dataset collect",
        &["--town", "town3", "--frames", "1", "--per-shard", "1", "--out", &path("data")],
    );
    check("net info", &["town5"]);
    check("doctor", &[]);
    assert_eq!(page.matches("\n## ").count(), sections, "each section is checked");
}
