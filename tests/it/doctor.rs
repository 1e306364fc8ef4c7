//! `wad-cosim doctor` on this machine, which has everything or could not run these tests.

use std::process::{Command, Output};

fn doctor(environment: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(["doctor", "--json"]).envs(environment.iter().copied());
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
    let output = doctor(&[]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));
    assert_eq!(status(&output, "SUMO"), "ok");
    assert_eq!(status(&output, "OpenVINO"), "ok");
    for (library, built_in) in [("libtorch", cfg!(feature = "learn")), ("OpenCV", cfg!(feature = "vision"))] {
        assert_eq!(status(&output, library), if built_in { "ok" } else { "optional" }, "{library}");
    }
}

#[test]
fn a_missing_sumo_ends_with_1() {
    let output = doctor(&[("WAD_COSIM_SUMO_HOME", "/nowhere")]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(status(&output, "SUMO"), "missing");
}

#[test]
fn a_missing_openvino_is_told_and_needed_where_libtorch_is_not_built_in() {
    let output = doctor(&[("WAD_COSIM_OPENVINO", "/nowhere")]);
    let expected = if cfg!(feature = "learn") { (Some(0), "optional") } else { (Some(1), "missing") };
    assert_eq!((output.status.code(), status(&output, "OpenVINO").as_str()), expected);
}
