//! `wad-cosim dataset` on a real SUMO.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::AtomicBool;
use wad_cosim::camera::model::ObjectClass;
use wad_cosim::dataset::{
    BoxRecord, CollectOptions, Dataset, FrameRecord, Manifest, NoiseParams, Role, collect as collect_frames,
};
use wad_cosim::world::SignalState;

fn wad(args: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(args).arg("--out").arg(folder).arg("--json").stdin(Stdio::null());
    command.output().expect("the binary runs")
}

fn collect(folder: &Path, args: &[&str]) -> Value {
    let output = wad(&[&["dataset", "collect"], args].concat(), folder);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a JSON line")
}

/// The frames of a dataset's first shard.
fn records(folder: &Path) -> Vec<FrameRecord> {
    let mut reader = Dataset::open(folder, false).unwrap().reader(0).unwrap();
    std::iter::from_fn(|| reader.next_record().unwrap()).collect()
}

fn shards(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut shards: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "wads"))
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(&path).unwrap()))
        .collect();
    shards.sort();
    shards
}

/// What a shard lost, torn or damaged costs is only itself, and collecting goes on with the very same bytes,
/// whatever the number of jobs. More frames than before make the last shard longer.
#[test]
fn collecting_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let args = |frames| ["--town", "town5", "--per-shard", "8", "--seed", "3", "--frames", frames];
    let first = folder.path().join("first");
    let result = collect(&first, &[&args("28")[..], &["--jobs", "2"]].concat());
    assert_eq!((result["frames"].as_u64(), result["complete"].as_bool()), (Some(28), Some(true)));
    let whole = shards(&first);
    assert_eq!(whole.len(), 4);
    let mut flipped = whole[0].1.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 4;
    std::fs::write(first.join("shard-00000.wads"), flipped).unwrap();
    std::fs::remove_file(first.join("shard-00001.wads")).unwrap();
    std::fs::write(first.join("shard-00002.wads"), &whole[2].1[..500]).unwrap();
    let result = collect(&first, &args("28"));
    assert_eq!(result["frames_before"].as_u64(), Some(4));
    assert!(shards(&first) == whole, "shards differ");
    let result = collect(&first, &args("32"));
    assert_eq!((result["frames_before"].as_u64(), result["frames"].as_u64()), (Some(24), Some(32)));
    assert!(shards(&first)[..3] == whole[..3], "shards differ");
    // Another seed is another dataset.
    let output =
        wad(&["dataset", "collect", "--town", "town5", "--frames", "32", "--per-shard", "8"], &first);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(error.contains("the seed") && error.contains('3'), "{error}");
}

/// A scenario's town is its net: frames of scenarios in town5 are never trained on.
#[test]
fn frames_of_a_scenario_belong_to_its_town() {
    let folder = tempfile::tempdir().unwrap();
    let result = collect(folder.path(), &["--town", "obstacle", "--frames", "8", "--max-minutes", "0"]);
    assert_eq!(result["town"], "town5");
    let manifest = Manifest::load(folder.path()).unwrap().unwrap();
    assert_eq!((manifest.town.as_str(), manifest.role), ("town5", Role::Test));
}

/// In the tick in which the ego is moved, the world around its new place is not known yet.
#[test]
fn no_frame_is_taken_in_the_tick_in_which_the_ego_is_moved() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = CollectOptions::new("town3", 300, folder.path());
    // A frame in every tick, and pushes off the road.
    (options.seed, options.per_segment, options.every) = (3, 300, 0.1);
    options.noise =
        NoiseParams { pause: 1.0, duration: [3.0, 5.0], lateral: [8.0, 9.0], ..NoiseParams::default() };
    collect_frames(&options, &AtomicBool::new(false), |_| {}).unwrap();
    let frames = records(folder.path());
    let moves: Vec<f64> = frames
        .windows(2)
        .filter(|pair| (pair[1].ego.pose.xy() - pair[0].ego.pose.xy()).norm() > 10.0)
        .map(|pair| pair[1].time - pair[0].time)
        .collect();
    // A tick is 0.167 s.
    assert!(!moves.is_empty() && moves.iter().all(|seconds| *seconds > 0.25), "{moves:?}");
}

/// With random signals the traffic is the same, and so is all that a frame shows but the lamps and what follows from them.
#[test]
fn random_signals_change_the_lamps_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--town", "town3", "--frames", "50", "--per-shard", "50", "--every", "1", "--seed", "3"];
    let frames = |name: &str, more: &[&str]| -> Vec<FrameRecord> {
        let path = folder.path().join(name);
        collect(&path, &[&args[..], more].concat());
        records(&path)
    };
    let (real, drawn) = (frames("real", &[]), frames("drawn", &["--random-signals"]));
    assert_eq!((real.len(), drawn.len()), (50, 50));
    let mut others = 0;
    for (real, drawn) in real.iter().zip(&drawn) {
        assert_eq!((real.time, real.ego, real.control), (drawn.time, drawn.ego, drawn.control));
        assert_eq!(real.boxes, drawn.boxes);
        let (Some((is, at)), Some((shown, drawn_at))) = (real.light, drawn.light) else { continue };
        others += usize::from(is != shown && at == drawn_at);
        if drawn.road.as_ref().is_some_and(|road| !road.heads.is_empty()) {
            assert!([SignalState::Red, SignalState::Yellow, SignalState::GreenMajor].contains(&shown));
        }
    }
    assert!(others > 5, "{others}");
    let shown = |state| drawn.iter().filter(|one| one.light.is_some_and(|(is, _)| is == state)).count();
    assert!(shown(SignalState::Yellow) > 1 && shown(SignalState::GreenMajor) > 1);
    // The same folder is not gone on with real ones.
    let output = wad(&[&["dataset", "collect"], &args[..]].concat(), &folder.path().join("drawn"));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && error.contains("signals are random"), "{error}");
}

/// With --near the ego looks from close behind somebody, and the labels are of that place.
#[test]
fn near_frames_show_somebody_close_ahead() {
    let folder = tempfile::tempdir().unwrap();
    let args =
        ["--town", "town3", "--frames", "30", "--per-shard", "30", "--every", "1", "--seed", "3", "--near"];
    let path = folder.path().join("near");
    collect(&path, &args);
    let frames = records(&path);
    let gaps: Vec<f64> = frames
        .iter()
        .map(|one| one.labels.lead.into_iter().chain(one.labels.pedestrian).fold(f64::INFINITY, f64::min))
        .collect();
    assert!(gaps.len() == 30 && gaps.iter().all(|gap| *gap <= 5.5), "{gaps:?}");
    // The autopilot keeps 2.5 m.
    assert!(gaps.iter().filter(|gap| **gap < 2.0).count() > 5, "{gaps:?}");
    // Whoever it is stands in the picture where the label says: the camera is 1.9 m behind the bumper or less.
    for (frame, gap) in frames.iter().zip(&gaps) {
        let shown = frame.boxes.iter().any(|b| f64::from(b.depth) > *gap && f64::from(b.depth) < gap + 14.0);
        assert!(shown, "{gap} m: {:?}", frame.boxes);
    }
    let output = wad(&[&["dataset", "collect"], &args[..10]].concat(), &path);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && error.contains("near"), "{error}");
}

/// With `--showing person` it looks from close behind people, whoever else is nearer.
#[test]
fn near_people_are_people() {
    let folder = tempfile::tempdir().unwrap();
    let args =
        ["--town", "town3", "--frames", "12", "--per-shard", "12", "--every", "1", "--seed", "3", "--near"];
    let path = folder.path().join("people");
    collect(&path, &[&args[..], &["--showing", "person"]].concat());
    let frames = records(&path);
    assert_eq!(frames.len(), 12);
    for frame in frames {
        let gap = frame.labels.pedestrian.unwrap_or(f64::INFINITY);
        let stands = |b: &&BoxRecord| f64::from(b.depth) > gap && f64::from(b.depth) < gap + 6.0;
        let shown = frame.boxes.iter().filter(|b| b.class == ObjectClass::Person).find(stands);
        assert!(gap <= 5.5 && shown.is_some(), "{gap} m: {:?}", frame.boxes);
    }
}

/// Plain images have nothing painted; all else stays.
#[test]
fn plain_images_show_the_camera_alone() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--town", "town3", "--frames", "20", "--per-shard", "20", "--every", "1", "--seed", "3"];
    let frames = |name: &str, more: &[&str]| {
        let path = folder.path().join(name);
        collect(&path, &[&args[..], more].concat());
        let mut reader = Dataset::open(&path, false).unwrap().reader(0).unwrap();
        std::iter::from_fn(move || reader.next_frame().unwrap()).collect::<Vec<_>>()
    };
    let (painted, plain) = (frames("painted", &[]), frames("plain", &["--plain"]));
    let blue = |frame: &wad_cosim::dataset::Frame| {
        frame.transformed.bytes().chunks_exact(3).filter(|pixel| *pixel == [0, 0, 255]).count()
    };
    for (painted, plain) in painted.iter().zip(&plain) {
        assert_eq!((painted.record.time, painted.record.ego), (plain.record.time, plain.record.ego));
        assert_eq!(painted.record.boxes, plain.record.boxes);
        assert_eq!(blue(plain), 0);
    }
    assert!(painted.iter().any(|frame| blue(frame) > 0));
    let output = wad(&[&["dataset", "collect"], &args[..]].concat(), &folder.path().join("plain"));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && error.contains("plain"), "{error}");
}

/// What varies is drawn for each shard, changes pictures and no drive, and does not depend on the jobs.
#[test]
fn streets_vary_from_shard_to_shard_and_the_drives_stay() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let args = ["--town", "town3", "--frames", "16", "--per-shard", "8", "--every", "1", "--seed", "3"];
    collect(&path("usual"), &args);
    collect(&path("one"), &[&args[..], &["--vary", "all"]].concat());
    collect(&path("two"), &[&args[..], &["--vary", "all", "--jobs", "2"]].concat());
    assert!(shards(&path("one")) == shards(&path("two")), "shards differ");
    for shard in 0..2 {
        let frames = |name: &str| {
            let mut reader = Dataset::open(&path(name), false).unwrap().reader(shard).unwrap();
            std::iter::from_fn(move || reader.next_frame().unwrap()).collect::<Vec<_>>()
        };
        for (usual, varied) in frames("usual").iter().zip(frames("one")) {
            let (here, there) = (&usual.record, &varied.record);
            assert_eq!((here.time, here.ego, here.control), (there.time, there.ego, there.control));
            assert!(usual.transformed != varied.transformed, "the same picture at {}", here.time);
        }
    }
    let output = wad(&[&["dataset", "collect"], &args[..]].concat(), &path("one"));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && error.contains("what varies"), "{error}");
    let output = wad(&["dataset", "collect", "--vary", "sun,moon"], &path("none"));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && error.contains("found `moon`"), "{error}");
}

/// A recorded run is driven again, looked at in each weather, and it is the run that was recorded.
#[test]
fn a_recorded_run_becomes_data() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let output = wad(&["run", "town5", "--traffic", "20,30", "--ticks", "60", "--seed", "5"], &run);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let data = folder.path().join("data");
    let from = run.to_string_lossy().into_owned();
    let args = ["--from", &from, "--weather", "ClearNoon,MidRainyNoon"];
    let result = collect(&data, &args);
    // 10 s less 2 s of warm-up, two frames a second at most.
    let frames = result["frames"].as_u64().unwrap();
    assert!((6..=32).contains(&frames) && frames.is_multiple_of(2), "{result}");
    assert_eq!((result["shards"].as_u64(), result["complete"].as_bool()), (Some(2), Some(true)));
    let mut info = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    let output = info.args(["dataset", "info"]).arg(&data).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("test data") && said.contains("MidRainyNoon"), "{said}");
    // Another way than the recorded one is noticed.
    let telemetry = run.join("telemetry.jsonl");
    let mut ticks: Vec<Value> = std::fs::read_to_string(&telemetry)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    for tick in &mut ticks[20..] {
        tick["control"] = serde_json::json!({"throttle": 1.0, "steer": 0.0, "brake": 0.0});
    }
    let lines: Vec<String> = ticks.iter().map(Value::to_string).collect();
    std::fs::write(&telemetry, lines.join("\n")).unwrap();
    let again = folder.path().join("again");
    let output = wad(&[&["dataset", "collect"], &args[..]].concat(), &again);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("does not repeat") && error.contains("tick"), "{error}");
    let output = wad(&["dataset", "collect", "--from", &data.to_string_lossy()], &again);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(error.contains("not a recorded run") && error.contains("config.json"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_told_and_finished_shards_stay() {
    let folder = tempfile::tempdir().unwrap();
    // The second shard goes to a device that is always full.
    std::os::unix::fs::symlink("/dev/full", folder.path().join("shard-00001.part")).unwrap();
    let args = ["--town", "town3", "--frames", "60", "--per-shard", "30", "--seed", "3"];
    let output = wad(&[&["dataset", "collect"], &args[..]].concat(), folder.path());
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("the disk is full") && error.contains("shard-00001"), "{error}");
    assert_eq!(shards(folder.path()).len(), 1);
    let result = collect(folder.path(), &args);
    assert_eq!((result["frames_before"].as_u64(), result["frames"].as_u64()), (Some(30), Some(60)));
}

#[test]
fn no_time_still_leaves_a_dataset_to_go_on_with() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--town", "town3", "--frames", "20", "--per-shard", "20"];
    let result = collect(folder.path(), &[&args[..], &["--max-minutes", "0"]].concat());
    assert_eq!((result["frames"].as_u64(), result["complete"].as_bool()), (Some(0), Some(false)));
    let mut info = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    let output = info.args(["dataset", "info"]).arg(folder.path()).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(error.contains("holds no frames"), "{error}");
}

/// Two writers into one folder would delete or repeat each other's work.
#[test]
fn a_folder_that_another_process_writes_is_refused_by_all_that_write_one() {
    let folder = tempfile::tempdir().unwrap();
    let lock = wad_cosim::folder_lock::FolderLock::take(folder.path()).unwrap();
    let mut commands = vec![vec!["dataset", "collect", "--town", "town5", "--frames", "8"]];
    commands.push(vec!["eval", "nocrash", "--agent", "random", "--episodes", "1"]);
    if cfg!(feature = "learn") {
        commands.push(vec!["train", "encoder", "--data", "missing"]);
        commands.push(vec!["train", "detector", "--data", "missing"]);
        commands.push(vec!["train", "agent", "--algo", "td3", "--encoder", "pooled"]);
    }
    for command in commands {
        let output = wad(&command, folder.path());
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{command:?}: {error}");
        assert!(error.contains("another process is writing"), "{command:?}: {error}");
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, [".lock"], "written in spite of the lock");
    drop(lock);
}
