//! What the ego sees, on a real SUMO: `run --perception`, `snapshot --stage`, `eval lanes`, `eval lead`.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn wad(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(args).stdin(Stdio::null()).output().expect("the binary runs")
}

fn good(args: &[&str]) -> Output {
    let output = wad(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

fn last_line(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("JSON")
}

/// Width, height and bytes of a PNG.
fn picture(path: &Path) -> (u32, u32, Vec<u8>) {
    let file = std::fs::File::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a frame");
    (info.width, info.height, bytes)
}

fn count(bytes: &[u8], colour: [u8; 3]) -> usize {
    bytes.chunks_exact(3).filter(|pixel| *pixel == colour).count()
}

#[test]
fn snapshot_shows_each_stage_and_the_same_one_again() {
    let dir = tempfile::tempdir().expect("a folder");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let take = |stage: &str, name: &str| {
        let out = at(name);
        good(&["snapshot", "town5", "--stage", stage, "--time", "14", "--seed", "2", "--out", &out]);
        picture(Path::new(&out))
    };
    let (width, height, transformed) = take("transformed", "t.png");
    assert_eq!((width, height), (128, 128));
    assert!(count(&transformed, [0, 0, 255]) > 0, "somebody is in sight");
    assert_eq!(take("transformed", "again.png").2, transformed);
    assert_eq!(take("detect", "d.png").0, 512);
    let (width, height, all) = take("all", "a.png");
    let panels = if cfg!(feature = "learn") { 4 } else { 3 };
    assert_eq!((width, height), (panels * 512, 512));
    assert!(count(&all, [0, 0, 255]) >= 12 * count(&transformed, [0, 0, 255]), "scaled by four");
}

#[test]
fn from_outside_the_ego_is_in_the_picture() {
    let dir = tempfile::tempdir().expect("a folder");
    let out = dir.path().join("c.png").to_string_lossy().into_owned();
    let common = ["snapshot", "town5", "--traffic", "empty", "--time", "2", "--overlay", "semantic", "--out"];
    for (view, seen) in [("front", false), ("chase", true), ("bird", true)] {
        good(&[&common[..], &[&out, "--view", view]].concat());
        let (width, height, bytes) = picture(Path::new(&out));
        // CARLA's colour of cars, in the middle half of the picture; beside it some are parked.
        let middle = |at: usize, size: u32| (size as usize / 4..3 * size as usize / 4).contains(&at);
        let car = bytes.chunks_exact(3).enumerate().filter(|(i, pixel)| {
            let (x, y) = (i % width as usize, i / width as usize);
            middle(x, width) && middle(y, height) && *pixel == [0, 0, 142]
        });
        assert_eq!(car.count() > 400, seen, "{view}");
    }
}

#[test]
fn a_run_with_perception_says_what_it_sees_and_films_the_stages() {
    let dir = tempfile::tempdir().expect("a folder");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let film = at("film/");
    let (out, plain) = (at("out"), at("plain"));
    let common = ["run", "town3", "--traffic", "30,30", "--ticks", "20", "--seed", "4", "--json", "--out"];
    let mut args = common.to_vec();
    args.extend([&out, "--perception", "--record", &film, "--record-view", "front"]);
    let output = good(&args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("sees ") && said.contains("lanes "), "{said}");
    let (width, height, _) = picture(&Path::new(&film).join("frame-000019.png"));
    // Three stages below the film, or four with the reconstruction.
    assert_eq!((width, height), (512, 512 + if cfg!(feature = "learn") { 128 } else { 170 }));
    // Looking changes nothing.
    let mut args = common.to_vec();
    args.push(&plain);
    good(&args);
    let telemetry = |out: &str| std::fs::read(Path::new(out).join("telemetry.jsonl")).expect("telemetry");
    assert_eq!(telemetry(&out), telemetry(&plain));
}

#[test]
fn the_film_of_all_views_holds_the_transformed_image() {
    let dir = tempfile::tempdir().expect("a folder");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let (out, film) = (at("out"), at("film/"));
    good(&[
        "run",
        "town5",
        "--traffic",
        "70,100",
        "--ticks",
        "30",
        "--seed",
        "2",
        "--out",
        &out,
        "--record",
        &film,
        "--record-view",
        "all",
    ]);
    let blue_or_green = (0..30).any(|n| {
        let (width, height, bytes) = picture(&Path::new(&film).join(format!("frame-{n:06}.png")));
        assert_eq!((width, height), (1280, 720));
        // The inset in the lower left corner.
        (400..704).any(|y| {
            let row = &bytes[3 * (1280 * y + 16)..3 * (1280 * y + 336)];
            count(row, [0, 0, 255]) + count(row, [0, 255, 0]) > 0
        })
    });
    assert!(blue_or_green);
}

#[test]
fn lanes_are_found_where_they_are_painted() {
    let result = last_line(&good(&[
        "eval",
        "lanes",
        "town5",
        "--ticks",
        "300",
        "--traffic",
        "10,10",
        "--weather",
        "ClearNoon",
        "--json",
    ]));
    let lanes = &result["rows"][0]["lanes"];
    assert!(lanes["painted"].as_u64() > Some(40), "{result}");
    assert!(lanes["recall"].as_f64() > Some(0.75), "{result}");
    assert!(lanes["lateral_error"]["median"].as_f64() < Some(0.15), "{result}");
}

#[test]
fn the_vehicle_in_front_is_where_it_is_seen() {
    let result = last_line(&good(&[
        "eval",
        "lead",
        "town5",
        "--ticks",
        "500",
        "--traffic",
        "150,100",
        "--seed",
        "3",
        "--json",
    ]));
    let bins = result["lead"]["bins"].as_array().expect("bins");
    let near: Vec<&Value> = bins.iter().filter(|bin| bin["to"].as_f64() <= Some(20.0)).collect();
    let frames: u64 = near.iter().filter_map(|bin| bin["frames"].as_u64()).sum();
    assert!(frames > 20, "{result}");
    for bin in near.iter().filter(|bin| bin["frames"].as_u64() > Some(10)) {
        assert!(bin["recall"].as_f64() > Some(0.8), "{bin}");
        assert!(bin["gap_error"]["median"].as_f64() < Some(1.5), "{bin}");
    }
    let crossing = &result["crossing"];
    assert!(crossing["free_frames"].as_u64() > Some(100), "{result}");
    assert!(crossing["false_leads"].as_f64() < Some(0.1), "{crossing}");
}

/// The shipped encoder's reconstruction shows what the transformed image does.
#[cfg(feature = "learn")]
#[test]
fn the_shipped_encoder_keeps_what_is_painted() {
    let dir = tempfile::tempdir().expect("a folder");
    let take = |stage: &str| {
        let out = dir.path().join(stage).with_extension("png").to_string_lossy().into_owned();
        good(&["snapshot", "town5", "--stage", stage, "--time", "20", "--seed", "2", "--out", &out]);
        picture(Path::new(&out)).2
    };
    let (transformed, latent) = (take("transformed"), take("latent"));
    let blue = |image: &[u8]| -> Vec<bool> {
        image.chunks_exact(3).map(|p| p[2] > 128 && p[0] < 100 && p[1] < 100).collect()
    };
    let (wanted, made) = (blue(&transformed), blue(&latent));
    let both = wanted.iter().zip(&made).filter(|(w, m)| **w && **m).count();
    let all = wanted.iter().filter(|w| **w).count();
    assert!(all > 30, "nobody in sight: choose another moment");
    assert!(both * 2 > all, "{both} of {all}");
}

/// From frames to a judged encoder by the commands alone.
#[cfg(feature = "learn")]
#[test]
fn an_encoder_is_trained_judged_and_shown() {
    let dir = tempfile::tempdir().expect("a folder");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let (training, measuring, out) = (at("town3"), at("town5"), at("encoder"));
    good(&[
        "dataset",
        "collect",
        "--town",
        "town3",
        "--frames",
        "40",
        "--per-shard",
        "20",
        "--out",
        &training,
    ]);
    good(&[
        "dataset",
        "collect",
        "--town",
        "town5",
        "--frames",
        "20",
        "--per-shard",
        "20",
        "--out",
        &measuring,
    ]);
    let trained = last_line(&good(&[
        "train",
        "encoder",
        "--data",
        &training,
        "--out",
        &out,
        "--epochs",
        "1",
        "--batch",
        "8",
        "--bfloat16",
        "--label-weight",
        "0.03",
        "--json",
    ]));
    assert_eq!(trained["epochs"].as_u64(), Some(1), "{trained}");
    assert!(trained["best"]["labels"].as_f64() > Some(0.0), "{trained}");
    assert!(
        std::fs::metadata(dir.path().join("encoder/encoder.safetensors")).expect("weights").len()
            < 12_000_000
    );
    for encoder in [out.as_str(), "default"] {
        let judged = last_line(&good(&[
            "eval",
            "encoder",
            "--encoder",
            encoder,
            "--data",
            &measuring,
            "--probe-data",
            &training,
            "--json",
        ]));
        assert_eq!((judged["frames"].as_u64(), judged["town"].as_str()), (Some(20), Some("town5")));
        let floor = if encoder == out { 3.0 } else { 17.0 };
        assert!(judged["psnr_db"].as_f64() > Some(floor), "{encoder}: {judged}");
    }
    let figure = at("figure.png");
    good(&["report", "latents", "--data", &measuring, "--out", &figure]);
    let (width, height, _) = picture(Path::new(&figure));
    assert!(width >= 4 * 128 && height >= 2 * 128, "{width}x{height}");
    // Test data is not trained on.
    let output = wad(&["train", "encoder", "--data", &measuring, "--out", &at("never")]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("test data"), "{error}");
    let output =
        wad(&["snapshot", "town5", "--stage", "latent", "--encoder", "nobody", "--out", &at("no.png")]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("`nobody`") && error.contains("default"), "{error}");
}

#[cfg(feature = "learn")]
#[test]
fn the_whole_tick_is_measured_stage_by_stage() {
    let args = ["bench", "tick", "--traffic", "10,10", "--ticks", "20", "--warm-up", "5", "--json"];
    let report = last_line(&good(&args));
    let names: Vec<&str> = report["stages"].as_object().expect("stages").keys().map(String::as_str).collect();
    for stage in ["sumo", "camera", "detect", "lanes", "transform", "encode"] {
        assert!(names.contains(&stage), "{stage} is not in {names:?}");
    }
}

#[test]
fn an_unknown_detector_is_an_input_error_that_names_the_known() {
    for args in [
        &["run", "town5", "--perception", "--detector", "eagle", "--ticks", "1"][..],
        &["snapshot", "town5", "--stage", "detect", "--detector", "eagle"],
        &["eval", "lanes", "--detector", "eagle"],
    ] {
        let dir = tempfile::tempdir().expect("a folder");
        let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
        let output = command.args(args).current_dir(dir.path()).output().expect("the binary runs");
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {error}");
        assert!(error.contains("eagle") && error.contains("truth"), "{error}");
    }
}
