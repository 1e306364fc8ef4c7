//! `train eyes` and `eval eyes` on a real SUMO: collected, trained, refused, scored.

use serde_json::Value;
use std::process::{Command, Output, Stdio};

fn wad(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(args).stdin(Stdio::null()).output().expect("the binary runs")
}

fn good(args: &[&str]) -> Value {
    let output = wad(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a JSON line")
}

#[test]
fn what_is_collected_is_trained_on_and_scored() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (data, out) = (path("data"), path("out"));
    let frames = ["--frames", "16", "--per-shard", "8", "--every", "1", "--camera", "--json"];
    good(&[&["dataset", "collect", "--out", &data], &frames[..]].concat());
    let short = ["--epochs", "1", "--batch", "2", "--epoch-steps", "1", "--init", "centernet", "--json"];
    let trained = good(&[&["train", "eyes", "--data", &data, "--out", &out], &short[..]].concat());
    let road = &trained["best"]["road"];
    assert!(road["frames"].as_u64() > Some(0), "{trained}");

    // What it sees is scored beside the objects.
    let weights = trained["detector"].as_str().unwrap().to_string();
    let (eyes, as_centernet) = (format!("eyes:{weights}"), format!("centernet:{weights}"));
    let few = ["--town", "town3", "--frames", "6", "--weather", "ClearNoon", "--json"];
    let scored = good(&[&["eval", "eyes", "--detector", &eyes], &few[..]].concat());
    let all = &scored["road"][1];
    assert_eq!((all[0].as_str(), all[1]["frames"].as_u64()), (Some("all"), Some(6)), "{scored}");
    assert!(all[1]["boundaries"].as_u64() > Some(0), "{scored}");
    // Beside it, the paper's chain: lanes by Canny and Hough, no light.
    let hough = good(&[&["eval", "eyes", "--detector", "centernet"], &few[..]].concat());
    assert_eq!(hough["road"][1][1]["boundaries"], all[1]["boundaries"], "other frames");
    assert!(hough["road"][1][1]["boundaries_found"].as_f64() > Some(0.5), "{hough}");

    // Each name wants its own network.
    for (detector, found) in [(as_centernet.as_str(), "network eyes"), ("eyes:missing", "missing")] {
        let output = wad(&["eval", "detector", "--detector", detector, "--frames", "1"]);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains(found), "{error}");
    }
}

/// `eval eyes` of the bundled eyes in `frames` frames of town5 in hard rain, with these variables.
fn bundled_eyes(frames: &str, variables: &[(&str, &str)]) -> (Value, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(["eval", "eyes", "--detector", "eyes", "--town", "town5", "--weather", "HardRainNoon"]);
    command.args(["--frames", frames, "--json"]).envs(variables.iter().copied()).stdin(Stdio::null());
    let output = command.output().expect("the binary runs");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{errors}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    (serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a JSON line"), errors)
}

/// Boundaries found, lights right, and the share of persons found.
fn shares(scored: &Value) -> [f64; 3] {
    let road = &scored["road"][1][1];
    let persons = &scored["realism"]["classes"]["person"];
    let share = persons["hits"].as_f64().unwrap() / persons["truths"].as_f64().unwrap();
    [road["boundaries_found"].as_f64().unwrap(), road["lights_right"].as_f64().unwrap(), share]
}

#[test]
fn the_bundled_eyes_see_the_same_on_other_processors_and_without_openvino() {
    let (here, errors) = bundled_eyes("60", &[]);
    assert!(!errors.contains("libtorch"), "{errors}");
    let best = shares(&here);
    // Canny and Hough find a third here.
    assert!(best[0] > 0.7, "{here}");
    assert!(best[1] > 0.7, "{here}");
    // Without VNNI; without AVX-512; libtorch in single precision.
    let others = [
        ("ONEDNN_MAX_CPU_ISA", "AVX512_CORE", 0.02),
        ("ONEDNN_MAX_CPU_ISA", "AVX2", 0.02),
        ("WAD_COSIM_OPENVINO", "off", 0.1),
        ("WAD_COSIM_OPENVINO", "/nowhere", 0.1),
    ];
    for (variable, value, most) in others {
        let (there, errors) = bundled_eyes("60", &[(variable, value)]);
        for (a, b) in best.iter().zip(shares(&there)) {
            assert!((a - b).abs() < most, "{variable}={value}: {best:?}, {:?}", shares(&there));
        }
        assert_eq!(errors.contains("found no OpenVINO in /nowhere"), value == "/nowhere", "{errors}");
    }
}
