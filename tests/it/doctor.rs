//! `wad-cosim doctor` on this machine, which has everything or could not run these tests.

use std::process::{Command, Output};

fn doctor(sumo_home: Option<&str>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(["doctor", "--json"]);
    if let Some(home) = sumo_home {
        command.env("WAD_COSIM_SUMO_HOME", home);
    }
    command.output().expect("wad-cosim starts")
}

/// The status of the check `name` in what doctor printed.
fn status(output: &Output, name: &str) -> String {
    let report: serde_json::Value =
        serde_json::from_slice(&output.stdout).expect("stdout is one JSON object");
    let checks = report["checks"].as_array().expect("checks is a list");
    let check = checks.iter().find(|check| check["name"] == name).expect("the check is listed");
    check["status"].as_str().expect("status is text").to_owned()
}

#[test]
fn finds_everything_needed() {
    let output = doctor(None);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));
    assert_eq!(status(&output, "SUMO"), "ok");
    for (library, built_in) in [("libtorch", cfg!(feature = "learn")), ("OpenCV", cfg!(feature = "vision"))] {
        assert_eq!(status(&output, library), if built_in { "ok" } else { "optional" }, "{library}");
    }
}

#[test]
fn a_missing_sumo_ends_with_1() {
    let output = doctor(Some("/nowhere"));
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(status(&output, "SUMO"), "missing");
}
