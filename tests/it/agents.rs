//! `train agent` on a real SUMO: it learns, stops on Ctrl-C, goes on, and what it wrote drives.

use super::program::{json, stderr, wad};
use serde_json::Value;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A small training behind the encoder that needs no weights.
const SMALL: [&str; 16] = [
    "--encoder",
    "pooled",
    "--buffer",
    "4000",
    "--batch",
    "32",
    "--learning-starts",
    "200",
    "--collectors",
    "2",
    "--checkpoint-every",
    "300",
    "--seed",
    "5",
    "--update-ratio",
    "1",
];

fn train(out: &Path, args: &[&str]) -> Command {
    let mut command = wad(&["train", "agent", "--json", "--out"]);
    command.arg(out).args(args);
    command
}

fn lines(file: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    text.lines().map(|line| serde_json::from_str(line).expect("a JSON line")).collect()
}

fn wait_until(child: &mut Child, what: &str, mut done: impl FnMut() -> bool) {
    let began = Instant::now();
    while !done() {
        assert!(child.try_wait().expect("a child").is_none(), "ended before {what}");
        assert!(began.elapsed() < Duration::from_secs(180), "no {what} within three minutes");
        std::thread::sleep(Duration::from_millis(100));
    }
}

fn checkpoints(out: &Path) -> usize {
    let count = |entries: std::fs::ReadDir| {
        entries.flatten().filter(|entry| entry.path().join("state.json").exists()).count()
    };
    std::fs::read_dir(out.join("checkpoints")).map_or(0, count)
}

#[test]
fn the_latent_is_small_beside_the_raw_states_unless_a_size_is_given() {
    let dir = tempfile::tempdir().unwrap();
    let cases: [(&str, &[&str], f64); 3] = [
        ("both", &[], 0.02),
        ("latent", &["--inputs", "latent"], 1.0),
        ("given", &["--inputs", "latent", "--latent-gain", "0.3"], 0.3),
    ];
    for (name, args, gain) in cases {
        let out = dir.path().join(name);
        let mut command = train(&out, &["--algo", "td3", "--steps", "1", "--validate-every", "0"]);
        let output = command.args(args).args(SMALL).output().unwrap();
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let config: Value = serde_json::from_slice(&std::fs::read(out.join("config.json")).unwrap()).unwrap();
        assert_eq!(config["latent_gain"], gain, "{name}");
    }
}

#[test]
fn wad_t_trains_stops_on_ctrl_c_goes_on_and_drives() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("wad_t");
    let mut command = train(&out, &["--algo", "td3", "--steps", "1000000", "--validate-every", "0"]);
    command.args(SMALL).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
    let mut child = command.spawn().unwrap();
    wait_until(&mut child, "a checkpoint", || checkpoints(&out) > 0);
    let pid = child.id() as i32;
    // SAFETY: sends a signal to a child that has not been waited for.
    assert_eq!(unsafe { libc::kill(pid, libc::SIGINT) }, 0);
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let first = json(&output);
    assert_eq!(first["interrupted"], true);
    let steps = first["steps"].as_u64().unwrap();
    let updates = first["updates"].as_u64().unwrap();
    assert!(steps >= 300 && updates > 0, "{first}");
    assert!(updates <= steps - 200, "one update per step: {first}");

    // Another algorithm in the same folder is refused, and so is a new start.
    let other = train(&out, &["--resume", "--algo", "sac"]).output().unwrap();
    assert_eq!(other.status.code(), Some(2));
    assert!(stderr(&other).contains("trains wad-t"), "{}", stderr(&other));
    let again = train(&out, &["--algo", "td3"]).args(SMALL).output().unwrap();
    assert_eq!(again.status.code(), Some(2));
    assert!(stderr(&again).contains("--resume"), "{}", stderr(&again));
    // So is what the training would not take.
    let rate = train(&out, &["--resume", "--learning-rate", "1e-4"]).output().unwrap();
    assert_eq!(rate.status.code(), Some(2));
    assert!(stderr(&rate).contains("--learning-rate"), "{}", stderr(&rate));

    let more = (steps + 300).to_string();
    let output = train(&out, &["--resume", "--collectors", "2", "--steps", &more]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let second = json(&output);
    let (all, updates) = (second["steps"].as_u64().unwrap(), second["updates"].as_u64().unwrap());
    assert!(all >= steps + 300 && updates == all - 200, "{second}");
    let log = lines(&out.join("train.jsonl"));
    assert!(log.iter().any(|line| line.get("losses/qf1_loss").is_some_and(Value::is_number)));
    assert!(log.iter().any(|line| line.get("charts/episodic_return").is_some_and(Value::is_number)));
    assert!(log.windows(2).all(|w| w[0]["global_step"].as_u64() <= w[1]["global_step"].as_u64()));

    // Its steps are kept, and they are done.
    let output = train(&out, &["--resume", "--collectors", "1", "--max-minutes", "0.2"]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(json(&output)["steps"].as_u64(), Some(all));
    assert!(stderr(&output).contains(&format!("the {more} steps are done")), "{}", stderr(&output));

    // What it wrote drives, the same way each time.
    let agent = out.join("last.safetensors");
    let drive = |name: &str| {
        let run = dir.path().join(name);
        let mut command = wad(&["run", "town3", "--traffic", "5,5", "--ticks", "40", "--json", "--agent"]);
        let output = command.arg(&agent).arg("--out").arg(&run).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(json(&output)["ticks"], 40);
        std::fs::read(run.join("telemetry.jsonl")).unwrap()
    };
    assert_eq!(drive("one"), drive("two"));
    let config = std::fs::read_to_string(dir.path().join("one/config.json")).unwrap();
    assert!(config.contains("pooled-8x8"), "the run says what its agent saw through");

    // Another encoder is refused.
    std::fs::write(dir.path().join("broken.safetensors"), b"nothing").unwrap();
    let broken = dir.path().join("broken.safetensors");
    let mut command = wad(&["run", "town3", "--ticks", "5", "--agent"]);
    let output = command.arg(&broken).arg("--out").arg(dir.path().join("three")).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("is not a trained agent"), "{}", stderr(&output));
}

/// A SUMO that `parent` started.
fn sumo_of(parent: u32) -> Option<i32> {
    std::fs::read_dir("/proc").ok()?.flatten().find_map(|entry| {
        let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
        // pid (comm) state ppid ...
        let (pid, rest) = stat.split_once(" (sumo) ")?;
        (rest.split_whitespace().nth(1)? == parent.to_string()).then(|| pid.parse().ok())?
    })
}

/// Whether there was such a process.
fn kill(pid: i32) -> bool {
    // SAFETY: sends a signal to a process that this test or its child started.
    unsafe { libc::kill(pid, libc::SIGKILL) == 0 }
}

#[test]
fn a_sumo_that_dies_costs_an_episode_and_a_killed_training_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let (out, record) = (dir.path().join("run"), dir.path().join("record"));
    let errors = dir.path().join("stderr");
    let mut command = train(&out, &["--algo", "td3", "--steps", "1000000", "--validate-every", "0"]);
    command.args(SMALL).args(["--bc-weight", "1", "--inputs", "latent"]).arg("--record").arg(&record);
    let mut child =
        command.stdout(Stdio::null()).stderr(std::fs::File::create(&errors).unwrap()).spawn().unwrap();
    let pid = child.id();
    wait_until(&mut child, "a SUMO", || sumo_of(pid).is_some());
    // It may still be starting: then it is started again, and nothing is lost. The first may have ended by
    // then.
    std::thread::sleep(Duration::from_secs(3));
    wait_until(&mut child, "a SUMO to kill", || sumo_of(pid).is_some_and(kill));
    wait_until(&mut child, "word of the loss", || {
        let text = std::fs::read_to_string(&errors).unwrap();
        text.contains("an episode is lost") || text.contains("SUMO is started again")
    });
    wait_until(&mut child, "a checkpoint after it", || checkpoints(&out) > 0);
    assert!(kill(i32::try_from(pid).unwrap()));
    child.wait().unwrap();
    assert!(!out.join("summary.json").exists(), "nothing was said at the end");

    let output = train(&out, &["--resume", "--collectors", "2", "--max-minutes", "0.1"]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let resumed = json(&output);
    assert!(resumed["steps"].as_u64().unwrap() >= 300, "{resumed}");

    // Raw states are recorded too where the agent gets the latent alone: one option of the route is 1.
    let mut episodes = std::fs::read_dir(&record).unwrap().map(|entry| entry.unwrap().path());
    let episode = episodes.find(|path| path.extension().is_some_and(|end| end == "episode")).unwrap();
    let bytes = std::fs::read(episode).unwrap();
    let first = &bytes[bytes.iter().position(|byte| *byte == b'\n').unwrap() + 1..];
    let image = u32::from_le_bytes(first[..4].try_into().unwrap()) as usize;
    assert!(image > 0 && first[4 + image..][..60].iter().any(|byte| *byte != 0));

    // What was recorded begins another agent behind another encoder or the same.
    let other = dir.path().join("other");
    let mut command = train(&other, &["--algo", "sac", "--steps", "1", "--pretrain", "20"]);
    command.args(SMALL).args(["--bc-weight", "1", "--validate-every", "0"]).arg("--recorded").arg(&record);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("recorded steps"), "{}", stderr(&output));
    assert!(json(&output)["demonstrated"].as_u64().unwrap() > 0);
}

/// What `train agent --inputs raw` makes drives without a picture, and `report learning` draws its course.
#[test]
fn raw_agents_train_without_a_picture_and_their_course_is_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let curriculum = dir.path().join("curriculum.json");
    let text = r#"{ "town": "town3", "weathers": ["ClearNoon"], "replay": 0.0, "stages": [
        { "task": "straight", "threshold": 0.0, "window": 2 }, { "task": "one_turn", "threshold": 1.0, "window": 20 }] }"#;
    std::fs::write(&curriculum, text).unwrap();
    let raw = |seed: &str, out: &Path| {
        let mut command = train(out, &["--algo", "td3", "--inputs", "raw", "--steps", "500", "--seed", seed]);
        command.args([
            "--learning-starts",
            "200",
            "--batch",
            "32",
            "--buffer",
            "5000",
            "--validate-every",
            "0",
        ]);
        command.arg("--curriculum").arg(&curriculum).args([
            "--set",
            "env.reward.lane=0.1",
            "--collectors",
            "1",
        ]);
        command
    };
    let record = dir.path().join("record");
    let runs = ["1", "2"].map(|seed| dir.path().join(seed));
    for (seed, out) in ["1", "2"].iter().zip(&runs) {
        let output = raw(seed, out).arg("--record").arg(&record).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(stderr(&output).contains("stage 1 (straight) is passed"), "{}", stderr(&output));
        let stages = &json(&output)["stages"];
        assert!(stages["camera"].as_f64().unwrap() < 1.0, "nothing is drawn: {stages}");
    }
    let config: Value = serde_json::from_slice(&std::fs::read(runs[0].join("config.json")).unwrap()).unwrap();
    assert_eq!(
        (&config["env"]["detector"], &config["env"]["reward"]["lane"]),
        (&"outlines".into(), &0.1.into())
    );

    // Without images it was recorded for raw inputs alone. A training that is refused leaves its folder free.
    let again = |inputs: &str| {
        let args = ["--algo", "td3", "--inputs", inputs, "--steps", "1", "--validate-every", "0"];
        let mut command = train(&dir.path().join("again"), &args);
        command.args(["--collectors", "1", "--batch", "32", "--buffer", "5000", "--recorded"]).arg(&record);
        command.output().unwrap()
    };
    let output = again("both");
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("it holds no images"), "{}", stderr(&output));
    let output = again("raw");
    assert!(output.status.success(), "{}", stderr(&output));

    let report = dir.path().join("report");
    let output = wad(&["report", "learning"]).args(&runs).arg("--out").arg(&report).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let svg = std::fs::read_to_string(report.join("learning-stage.svg")).unwrap();
    assert!(svg.contains("wad-t, raw, reward only, seeds 1, 2") && svg.contains("<polygon"), "{svg}");
    let table = std::fs::read_to_string(report.join("learning.md")).unwrap();
    assert!(table.lines().filter(|line| line.contains(" steps, ")).count() == 2, "{table}");

    let policy = runs[0].join("last.safetensors").display().to_string();
    let out = dir.path().join("run").display().to_string();
    let args = [
        "run",
        "town3",
        "--agent",
        &policy,
        "--detector",
        "outlines",
        "--ticks",
        "20",
        "--out",
        &out,
        "--json",
    ];
    let output = wad(&args).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(json(&output)["ticks"], 20);

    for (setting, expected) in
        [("env.reward.lain=0", "lane_threshold"), ("update_ratio=fast", "expected"), ("seed", "PATH=VALUE")]
    {
        let fresh = dir.path().join("fresh");
        let output = raw("1", &fresh).args(["--set", setting]).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{setting}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{setting}: {}", stderr(&output));
        assert!(!fresh.exists(), "{setting}: nothing is written");
    }
}

/// Six egos in one SUMO fill one buffer; a validation comes between their ticks; it goes on after its end, and what
/// it made drives with what it observes: the surroundings as numbers.
#[test]
fn a_fleet_trains_on_the_surroundings_is_validated_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let curriculum = dir.path().join("curriculum.json");
    let text = r#"{ "town": "town3", "weathers": ["ClearNoon"], "replay": 0.3, "stages": [
        { "task": "straight", "threshold": 0.0, "window": 2 },
        { "task": "composite", "threshold": 1.0, "window": 20, "traffic": "5,5" }] }"#;
    std::fs::write(&curriculum, text).unwrap();
    let out = dir.path().join("fleet");
    let args = ["--algo", "sac", "--inputs", "vector", "--egos", "6", "--collectors", "1", "--steps", "900"];
    let mut command = train(&out, &args);
    command.args(["--learning-starts", "200", "--batch", "32", "--buffer", "5000", "--update-ratio", "0.2"]);
    command
        .args(["--validate-every", "500", "--validation-episodes", "1"])
        .arg("--curriculum")
        .arg(&curriculum);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let stages = &json(&output)["stages"];
    assert!(stages["camera"].as_f64().unwrap() < 1.0, "nothing is drawn: {stages}");
    let episodes = lines(&out.join("train.jsonl"));
    let tasks = |name: &str| episodes.iter().filter(|line| line["task"] == name).count();
    assert!(tasks("straight") > 2 && tasks("composite") > 0, "{episodes:?}");
    assert!(!lines(&out.join("validation.jsonl")).is_empty());

    let output = train(&out, &["--resume", "--steps", "1200", "--collectors", "1"]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(json(&output)["steps"].as_u64().unwrap() >= 1200);

    let policy = out.join("last.safetensors").display().to_string();
    let suite = dir.path().join("suite").display().to_string();
    let args =
        ["eval", "tasks", "--agent", &policy, "--episodes", "1", "--condition", "training", "--out", &suite];
    let output = wad(&args).args(["--task", "straight"]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));

    for (args, expected) in [
        (["--egos", "2", "--record", "records"], "--egos is 2"),
        (["--inputs", "vector", "--record", "records"], "--inputs vector"),
        (["--inputs", "vector", "--recorded", "records"], "--inputs vector"),
        (["--inputs", "raw", "--detector", "nothing"], "no detector has this name"),
    ] {
        let output = train(&dir.path().join("no"), &["--algo", "td3"]).args(args).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{args:?}: {}", stderr(&output));
        assert!(!dir.path().join("no").exists());
    }
}

#[test]
fn wad_s_learns_from_demonstrations_and_is_validated() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("wad_s");
    let curriculum = dir.path().join("curriculum.json");
    let text = r#"{ "town": "town3", "weathers": ["ClearNoon"], "replay": 0.0,
        "stages": [{ "task": "obstacle", "threshold": 0.9, "window": 20 }] }"#;
    std::fs::write(&curriculum, text).unwrap();
    let mut command = train(&out, &["--algo", "sac", "--steps", "200", "--demonstrations", "400"]);
    command.args(["--clone", "64", "--pretrain", "50"]);
    command.args(["--validate-every", "1000", "--validation-episodes", "1"]);
    let output = command.arg("--curriculum").arg(&curriculum).args(SMALL).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let trained = json(&output);
    assert!(trained["demonstrated"].as_u64().unwrap() >= 400, "{trained}");
    let (steps, updates) = (trained["steps"].as_u64().unwrap(), trained["updates"].as_u64().unwrap());
    assert_eq!(updates, steps + 50, "updates on the demonstrations, then one per step");
    assert!(trained["best"]["success_rate"].is_number(), "{trained}");
    let validated: Vec<_> =
        lines(&out.join("validation.jsonl")).iter().map(|line| line["global_step"].clone()).collect();
    assert_eq!(validated, [0.into(), steps.into()] as [Value; 2], "as cloned, and at the end");
    assert!(out.join("best.safetensors").exists());
    let log = lines(&out.join("train.jsonl"));
    assert!(log.iter().any(|line| line["by"] == "autopilot"), "reported apart");

    std::fs::write(&curriculum, text.replace("replay", "repaly")).unwrap();
    let mut command = train(&dir.path().join("other"), &["--algo", "sac"]);
    let output = command.arg("--curriculum").arg(&curriculum).args(SMALL).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("repaly"), "{}", stderr(&output));
}

#[test]
fn a_training_begins_with_a_trained_actor_of_its_own_kind() {
    let dir = tempfile::tempdir().unwrap();
    let begin = |out: &str, args: &[&str]| {
        let args =
            [&["--steps", "1", "--validate-every", "0", "--collectors", "1", "--buffer", "4000"], args];
        train(&dir.path().join(out), &args.concat()).output().unwrap()
    };
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/models/wad_t/agent.safetensors");
    let output = begin("t", &["--algo", "td3", "--init", shipped]);
    assert!(output.status.success(), "{}", stderr(&output));
    // A file is its header's length, its header, the actor and the scale of its inputs.
    let numbers = |path: &Path| {
        let bytes = std::fs::read(path).unwrap();
        let header = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        bytes[8 + header..].to_vec()
    };
    let begun = numbers(&dir.path().join("t/last.safetensors"));
    assert!(begun == numbers(Path::new(shipped)), "nothing was learned, so nothing differs");
    let config = std::fs::read_to_string(dir.path().join("t/config.json")).unwrap();
    assert!(config.contains("agent.safetensors"), "the run says what it began with");

    for (args, expected) in [
        (["--algo", "sac", "--init", shipped, "--inputs", "both"], "expected a wad-s to start with"),
        (["--algo", "td3", "--init", shipped, "--inputs", "raw"], "with the inputs Raw"),
        (["--algo", "td3", "--init", "nobody", "--inputs", "both"], "no agent is called `nobody`"),
    ] {
        let output = begin("other", &args);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{args:?}: {}", stderr(&output));
        assert!(!dir.path().join("other/config.json").exists(), "a refused training leaves its folder free");
    }
}

#[test]
fn a_replay_buffer_beyond_memory_is_refused_with_its_size() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let args = ["--algo", "td3", "--encoder", "pooled", "--buffer", "4000000000"];
    let output = train(&out, &args).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("MB of memory are free"), "{}", stderr(&output));
}

#[test]
fn a_flipped_bit_in_any_shipped_weights_is_noticed() {
    use wad_cosim::agent::policy::Policy;
    use wad_see::weights::Weights;
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let dir = tempfile::tempdir().unwrap();
    let mut tried = 0;
    for folder in std::fs::read_dir(&models).unwrap().map(|entry| entry.unwrap().path()) {
        let files = std::fs::read_dir(&folder).into_iter().flatten().map(|entry| entry.unwrap().path());
        for file in files.filter(|file| file.extension().is_some_and(|end| end == "safetensors")) {
            let mut bytes = std::fs::read(&file).unwrap();
            let last = bytes.len() - 2;
            bytes[last] ^= 1;
            let damaged = dir.path().join("damaged.safetensors");
            std::fs::write(&damaged, bytes).unwrap();
            let error = if file.ends_with("agent.safetensors") {
                Policy::load(&damaged).err().map(|error| error.to_string())
            } else {
                Weights::load(&damaged).err().map(|error| error.to_string())
            };
            let error = error.unwrap_or_else(|| panic!("{}: unnoticed", file.display()));
            assert!(error.contains("damaged"), "{error}");
            tried += 1;
        }
    }
    assert!(tried >= 5, "{tried}");
}
