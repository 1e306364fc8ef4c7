//! Benchmarks on a real SUMO: the same table however it was driven, external agents, replays, reports.

use super::program::{json, stderr, wad};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use wad_cosim::eval::kept::Kept;

/// A suite of short episodes, in a folder of its own.
struct Small {
    folder: TempDir,
    suite: String,
}

impl Small {
    fn new(ticks: u64, episodes: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("small.json");
        let text = format!(
            r#"{{"name": "small", "title": "Small", "episodes": {episodes},
                "conditions": [{{"name": "wet", "town": "town3", "weathers": ["WetNoon"]}}],
                "tasks": [{{"name": "busy", "kind": "composite", "traffic": "6,6", "tick_limit": {ticks}}}]}}"#
        );
        std::fs::write(&path, text).unwrap();
        let suite = path.display().to_string();
        Self { folder, suite }
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn eval(&self, out: &str, args: &[&str]) -> Command {
        let mut command = wad(&["eval", &self.suite, "--json", "--out"]);
        command.arg(self.out(out)).args(args);
        command
    }
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn ok(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    output
}

#[test]
fn the_table_is_the_same_killed_and_resumed_in_parallel_or_in_shards() {
    let small = Small::new(50, 5);
    let agents = ["--agent", "autopilot", "--agent", "constant"];
    let with = |more: &[&'static str]| [&agents, more].concat();
    let whole = json(&ok(&mut small.eval("whole", &agents)));
    assert_eq!((whole["episodes"].as_u64(), whole["planned"].as_u64()), (Some(10), Some(10)));
    assert_eq!(whole["rows"][0]["agent"], "autopilot");
    assert_eq!(whole["rows"][0]["success_rate"], 1.0, "alive after 50 ticks: {}", whole["rows"][0]);

    let episodes = small.out("cut").join("episodes.jsonl");
    let mut child = small.eval("cut", &with(&["--jobs", "2"])).stdout(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    while std::fs::read_to_string(&episodes).map_or(0, |text| text.lines().count()) < 2 {
        assert!(began.elapsed() < Duration::from_secs(120), "no two episodes within two minutes");
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    // As a kill in the middle of a line leaves it.
    let text = read(&episodes);
    std::fs::write(&episodes, &text[..text.len() - 40]).unwrap();
    let refused = small.eval("cut", &agents).output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("--resume"), "{}", stderr(&refused));
    let output = ok(&mut small.eval("cut", &with(&["--jobs", "2", "--resume"])));
    assert!(stderr(&output).contains("half-written"), "{}", stderr(&output));
    let table = |out: &str| read(&small.out(out).join("summary.json"));
    assert_eq!(table("whole"), table("cut"));

    ok(&mut small.eval("one", &with(&["--shard", "1/2"])));
    ok(&mut small.eval("two", &with(&["--shard", "2/2"])));
    let merge = |runs: &[&str], out: &str| {
        let mut command = wad(&["eval", "merge"]);
        command.args(runs.iter().map(|run| small.out(run))).arg("--out").arg(small.out(out));
        command.output().unwrap()
    };
    let merged = merge(&["two", "one"], "all");
    assert!(merged.status.success(), "{}", stderr(&merged));
    assert_eq!(table("whole"), table("all"));

    ok(&mut small.eval("other", &["--agent", "constant", "--seed", "3"]));
    let mixed = merge(&["one", "other"], "mixed");
    assert_eq!(mixed.status.code(), Some(2));
    assert!(stderr(&mixed).contains("selection.seeds"), "{}", stderr(&mixed));
    let mixed = small.eval("whole", &with(&["--resume", "--detector", "truth"])).output().unwrap();
    assert_eq!(mixed.status.code(), Some(2));
    assert!(stderr(&mixed).contains("options.detector"), "{}", stderr(&mixed));
}

#[test]
fn egos_that_share_a_sumo_drive_the_same_in_any_order_and_are_verified() {
    let small = Small::new(40, 5);
    // Weathers in turn, as in the suites of composites: each ego has its own.
    let asked = ["--weathers-in-turn", "--weather", "WetNoon", "--weather", "ClearNoon", "--keep", "all"];
    let egos = [&asked[..], &["--egos", "3"]].concat();
    let with = |more: &[&'static str]| [&egos[..], more].concat();
    let whole = json(&ok(&mut small.eval("whole", &egos)));
    assert_eq!((whole["episodes"].as_u64(), whole["planned"].as_u64()), (Some(5), Some(5)));
    assert_eq!(whole["rows"][0]["success_rate"], 1.0, "alive after 40 ticks: {}", whole["rows"][0]);
    ok(&mut small.eval("jobs", &with(&["--jobs", "2"])));
    ok(&mut small.eval("one", &with(&["--shard", "1/2"])));
    ok(&mut small.eval("two", &with(&["--shard", "2/2"])));
    let mut merge = wad(&["eval", "merge", "--out"]);
    ok(merge.arg(small.out("merged")).args([small.out("two"), small.out("one")]));
    let table = |out: &str| read(&small.out(out).join("summary.json"));
    let lines = |out: &str| {
        let text = read(&small.out(out).join("episodes.jsonl"));
        text.lines().map(String::from).collect::<std::collections::BTreeSet<_>>()
    };
    for other in ["jobs", "merged"] {
        assert_eq!(lines("whole"), lines(other));
        assert_eq!(table("whole"), table(other));
    }
    // Cut after the first episode: the group is driven again, its results count once.
    let episodes = small.out("jobs").join("episodes.jsonl");
    let first = read(&episodes).lines().next().unwrap().to_string();
    std::fs::write(&episodes, first + "\n").unwrap();
    let resumed = json(&ok(&mut small.eval("jobs", &with(&["--resume"]))));
    assert_eq!((resumed["driven"].as_u64(), resumed["episodes"].as_u64()), (Some(4), Some(5)));
    assert_eq!(lines("whole"), lines("jobs"));
    // Alone they would drive otherwise: the numbers are not mixed.
    let alone = small.eval("whole", &[&asked[..], &["--resume"]].concat()).output().unwrap();
    assert_eq!(alone.status.code(), Some(2));
    assert!(stderr(&alone).contains("egos: expected 3, found"), "{}", stderr(&alone));
    // Another than the first of a group is driven again among its fellows.
    let mut kept: Vec<PathBuf> =
        std::fs::read_dir(small.out("whole").join("episodes")).unwrap().map(|e| e.unwrap().path()).collect();
    kept.sort();
    assert_eq!(kept.len(), 5);
    // By weather: the episodes 1, 3, then 0, 2, 4.
    for (episode, together) in [(&kept[0], 3), (&kept[4], 2)] {
        assert_eq!(Kept::open(episode).unwrap().0.group.len(), together);
        let answer = json(&ok(wad(&["replay", "--verify", "--json"]).arg(episode)));
        assert_eq!(answer["verify"]["same"], true, "{answer}");
        assert_eq!(answer["verify"]["ticks"], 41, "{answer}");
    }
}

#[test]
fn results_of_others_are_not_trusted() {
    let small = Small::new(10, 2);
    // What is asked for twice counts once, and a word is said.
    let asked = ["--agent", "constant", "--agent", "constant", "--seed", "3", "--seed", "3", "--keep", "all"];
    let output = ok(&mut small.eval("run", &asked));
    assert_eq!(json(&output)["episodes"], 2);
    assert!(stderr(&output).contains("--seed 3 is given more than once"), "{}", stderr(&output));
    let run = small.out("run");
    let (episodes, whole) = (run.join("episodes.jsonl"), read(&run.join("episodes.jsonl")));
    let merge =
        |out: &str| wad(&["eval", "merge"]).arg(&run).arg("--out").arg(small.out(out)).output().unwrap();

    // A recording's path that leads elsewhere: nothing is read or written there.
    let victim = small.out("victim");
    std::fs::create_dir(&victim).unwrap();
    std::fs::write(victim.join("file"), "precious").unwrap();
    for path in [victim.display().to_string(), "../victim".to_string()] {
        let mut line: serde_json::Value = serde_json::from_str(whole.lines().next().unwrap()).unwrap();
        line["recording"] = path.clone().into();
        std::fs::write(&episodes, format!("{line}\n")).unwrap();
        let refused = merge("merged");
        assert_eq!(refused.status.code(), Some(2));
        let error = stderr(&refused);
        assert!(
            error.contains(&path) && error.contains("line 1") && error.contains("episodes/NAME"),
            "{error}"
        );
        assert_eq!(read(&victim.join("file")), "precious");
        assert!(!small.out("merged").exists(), "a merge that fails leaves nothing");
        let report = wad(&["report"]).arg(&run).output().unwrap();
        assert_eq!(report.status.code(), Some(2), "{}", stderr(&report));
    }

    // Lines that are no episodes of this evaluation are named, and do not count.
    let foreign = whole.lines().next().unwrap().replace("\"seed\":3", "\"seed\":4");
    let first = whole.lines().next().unwrap();
    std::fs::write(&episodes, format!("{first}\n{foreign}\nno episode\n")).unwrap();
    let report = ok(wad(&["report", "--thumbnails", "0"]).arg(&run));
    for part in ["line 2", "line 3", "1 of the plan's episodes missing"] {
        assert!(stderr(&report).contains(part), "{part}: {}", stderr(&report));
    }
    assert!(read(&run.join("report/report.md")).contains("n 1"));

    // Without the file that says what they were made by, results are nobody's.
    std::fs::remove_file(run.join("config.json")).unwrap();
    for more in [&asked[..], &[&asked[..], &["--resume"]].concat()] {
        let refused = small.eval("run", more).output().unwrap();
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains("no config.json"), "{}", stderr(&refused));
    }

    std::fs::write(&episodes, &whole).unwrap();
    ok(&mut small.eval("again", &asked));
    std::fs::remove_dir_all(small.out("again").join("episodes")).unwrap();
    let merge = || {
        wad(&["eval", "merge"]).arg(small.out("again")).arg("--out").arg(small.out("all")).output().unwrap()
    };
    assert_eq!(merge().status.code(), Some(2), "the recordings are gone");
    std::fs::rename(run.join("episodes"), small.out("again").join("episodes")).unwrap();
    let merged = merge();
    assert!(merged.status.success(), "the same --out serves: {}", stderr(&merged));
}

#[test]
fn a_failure_is_replayed_to_the_bit_and_reported() {
    let small = Small::new(200, 2);
    let reckless = "constant:1,0.4,0";
    let result = json(&ok(&mut small.eval("run", &["--agent", reckless])));
    assert_eq!(result["totals"][0]["successes"], 0, "{}", result["totals"][0]);
    let run = small.out("run");
    let kept: Vec<PathBuf> =
        std::fs::read_dir(run.join("episodes")).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(kept.len(), 2, "every failure is kept");
    let film = small.out("film/");
    let mut replay =
        wad(&["replay", "--verify", "--json", "--last", "0.4", "--record-view", "bird", "--record"]);
    let film_folder = format!("{}/", film.display());
    let answer = json(&ok(replay.arg(&film_folder).arg(&kept[0])));
    assert_eq!(answer["verify"]["same"], true, "{answer}");
    assert_eq!(answer["verify"]["ticks"].as_u64(), answer["ticks"].as_u64().map(|ticks| ticks + 1));
    assert_eq!(std::fs::read_dir(&film).unwrap().count(), 2, "two pictures in 0.4 s");
    let look = |detector| {
        wad(&["replay", "--json", "--last", "0.4", "--detector", detector]).arg(&kept[0]).output().unwrap()
    };
    let answer = json(&look("truth"));
    let looks = answer["looks"].as_array().unwrap();
    assert_eq!((looks.len(), &looks[1]["tick"]), (2, &answer["ticks"]));
    assert_eq!(looks[1]["light"]["seen"], looks[1]["light"]["there"], "the simulator tells it: {}", looks[1]);
    assert_eq!(look("nobody").status.code(), Some(2));

    // A recording that tells another story is found out.
    let episode = kept[0].join("episode.json");
    std::fs::write(&episode, read(&episode).replace("constant:1,0.4,0", "constant:1,0.41,0")).unwrap();
    let differs = wad(&["replay", "--verify", "--json"]).arg(&kept[0]).output().unwrap();
    assert_eq!(differs.status.code(), Some(1));
    let answer = json(&differs);
    assert_eq!(answer["verify"]["first_difference"][0], 1, "{answer}");

    let answer = json(&ok(wad(&["report", "--json", "--thumbnails", "1"]).arg(&run)));
    assert_eq!(answer["pictures"], 1);
    let page = read(&run.join("report/index.html"));
    let outside = page.replace("http://www.w3.org/2000/svg", "");
    assert!(!outside.contains("http") && !outside.contains("<script"), "one page that needs nothing else");
    assert!(page.contains("data:image/") && page.contains("How episodes ended") && page.contains("<svg"));
    let table = read(&run.join("report/report.md"));
    assert!(table.contains("0.0 % [0.0–65.8], n 2"), "{table}");
    assert!(read(&run.join("report/report.tex")).contains("\\begin{tabular}"));
    assert!(read(&run.join("report/report.csv")).contains("Small: success"));
}

#[test]
fn a_drive_without_an_end_is_looked_at_beyond_its_first_destination() {
    let small = Small::new(1800, 1);
    let endless =
        read(Path::new(&small.suite)).replace("\"tick_limit\"", "\"endless\": true, \"tick_limit\"");
    std::fs::write(&small.suite, endless).unwrap();
    ok(&mut small.eval("run", &["--keep", "all"]));
    let folder = std::fs::read_dir(small.out("run/episodes")).unwrap().next().unwrap().unwrap().path();
    let (_, recording) = Kept::open(&folder).unwrap();
    let first = 5.0 * recording.header().route.len() as f64;
    let end = recording.frames().last().unwrap().s;
    assert!(end > first, "{end} m: a drive beyond the {first} m of its first route tells more");
    let answer = ok(wad(&["replay", "--json", "--last", "0.4", "--detector", "truth"]).arg(&folder));
    assert_eq!(json(&answer)["looks"].as_array().unwrap().len(), 2, "{}", stderr(&answer));
}

#[test]
fn detectors_have_lines_of_their_own_and_a_pool_has_one() {
    let small = Small::new(30, 2);
    let agent = |name: &str, throttle: &str| {
        let script = small.out(name);
        let answer = format!("{{\"throttle\": {throttle}, \"steer\": 0, \"brake\": 0}}");
        let text = format!("echo '{{}}'; while read -r line; do echo '{answer}'; done");
        std::fs::write(&script, text).unwrap();
        format!("exec:sh {}", script.display())
    };
    let (slow, fast) = (agent("slow", "0.2"), agent("fast", "0.4"));
    let agents = ["--agent", &slow, "--agent", &fast, "--agent", "autopilot"];
    ok(&mut small.eval("truth", &[&agents[..], &["--detector", "truth"]].concat()));
    ok(&mut small.eval("outlines", &[&agents[..4], &["--detector", "outlines"]].concat()));
    let report = |pool: &str| {
        let mut command = wad(&["report", "--pool", pool]);
        command.arg(small.out("truth")).arg(small.out("outlines")).output().unwrap()
    };
    let output = report(&format!("both={slow},{fast}"));
    assert!(output.status.success(), "{}", stderr(&output));
    let table = read(&small.out("truth/report/report.md"));
    assert!(table.contains("| agent | condition | busy |"), "{table}");
    let rate = |driver: &str| {
        let own = table.lines().find(|line| line.starts_with(&format!("| {driver} | wet |")));
        let [deviates, four, two] =
            [" ± ", "n 4", "n 2"].map(|part| own.is_some_and(|line| line.contains(part)));
        (deviates, four, two)
    };
    for pool in ["both, truth", "both, outlines"] {
        assert_eq!(rate(pool), (true, true, false), "a pool has a deviation, and all its episodes: {table}");
    }
    assert_eq!(rate("autopilot"), (false, false, true), "{table}");
    assert!(
        table.contains("trainings, whose deviation is given: both, truth of 2; both, outlines of 2"),
        "{table}"
    );
    // With another suite there is a table of all.
    let suite = read(Path::new(&small.suite)).replace("small", "calm").replace("busy", "walk");
    let calm = small.out("calm.json");
    std::fs::write(&calm, suite).unwrap();
    ok(wad(&["eval"]).arg(&calm).args(["--agent", "autopilot", "--out"]).arg(small.out("calm")));
    ok(wad(&["report"]).args(["truth", "outlines", "calm"].map(|run| small.out(run))));
    let table = read(&small.out("truth/report/report.md"));
    let all = table.split("\n## ").next().unwrap();
    assert!(all.contains("| agent | condition | small: busy | calm: walk |"), "{table}");
    assert!(all.contains("| autopilot | wet | 2 of 2 | 2 of 2 |"), "{table}");
    let slow = all.lines().find(|line| line.contains("slow") && line.contains("outlines")).unwrap();
    assert!(slow.contains(" of 2 | - |"), "{slow}");
    let output = report("both=wad-t");
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("no run has the agent wad-t; there are autopilot, exec:"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_detector_that_does_not_exist_is_refused_before_the_folder_is_made() {
    let small = Small::new(10, 1);
    let output = small.eval("no", &["--agent", "wad-t", "--detector", "nothing"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("detector nothing: no detector has this name"), "{}", stderr(&output));
    assert!(!small.out("no").exists(), "its folder stays free");
}

/// A SUMO that dies says nothing about the recording: before, the verdict was that the episode "ended earlier".
#[test]
fn a_sumo_that_dies_while_an_episode_is_verified_is_no_difference() {
    let small = Small::new(1500, 1);
    ok(&mut small.eval("run", &["--agent", "autopilot", "--keep", "all"]));
    let kept = std::fs::read_dir(small.out("run").join("episodes")).unwrap().next().unwrap().unwrap().path();
    let mut replay = wad(&["replay", "--verify"]);
    let mut child = replay.arg(&kept).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let began = Instant::now();
    // SUMO is switched out about once a tick, since it waits for the next: after so many it is within the episode.
    let switches = |pid: i32| -> u64 {
        let text = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        let counts = text.lines().filter(|line| line.contains("ctxt_switches"));
        counts.filter_map(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok()).sum()
    };
    while child.try_wait().unwrap().is_none() {
        if let Some(pid) = super::run::sumo_of(child.id()).filter(|&pid| switches(pid) > 300) {
            // SAFETY: kill() only takes numbers; the process is this test's own child's.
            unsafe { libc::kill(pid, libc::SIGKILL) };
        }
        assert!(began.elapsed() < Duration::from_secs(120), "it goes on without a SUMO");
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stderr(&output).contains("SUMO"), "{}", stderr(&output));
}

/// `--view` called it bad input.
#[test]
fn a_kept_episode_without_a_sumo_is_exit_code_3() {
    let small = Small::new(10, 1);
    ok(&mut small.eval("run", &["--keep", "all"]));
    let kept = std::fs::read_dir(small.out("run").join("episodes")).unwrap().next().unwrap().unwrap().path();
    for how in [&["--view", "127.0.0.1:0"][..], &["--verify"]] {
        let mut replay = wad(&["replay"]);
        replay.arg(&kept).args(how).env("WAD_COSIM_SUMO_HOME", small.out("nothing"));
        let output = replay.output().unwrap();
        assert_eq!(output.status.code(), Some(3), "{how:?}: {}", stderr(&output));
    }
}

/// OpenCV does not say that a film cannot be written: a full disk once ended with 0 and a film that no player opens.
#[cfg(feature = "vision")]
#[test]
fn a_film_that_a_full_disk_or_ctrl_c_cuts_off_is_told() {
    let small = Small::new(400, 1);
    ok(&mut small.eval("run", &["--agent", "autopilot", "--keep", "all"]));
    let kept = std::fs::read_dir(small.out("run").join("episodes")).unwrap().next().unwrap().unwrap().path();
    // A limit on file sizes behaves like a full disk once the signal for it is ignored. Blocks of 1 KiB.
    let script = "trap '' XFSZ; ulimit -f 64; exec \"$@\"";
    let record = |out: &Path| {
        let mut command = Command::new("bash");
        command.args(["-c", script, "bash", env!("CARGO_BIN_EXE_wad-cosim"), "replay"]);
        command.arg(&kept).arg("--record").arg(out).stdin(Stdio::null()).output().unwrap()
    };
    for name in ["film.mp4", "film/"] {
        let output = record(&small.out(name));
        assert_eq!(output.status.code(), Some(1), "{name}: {}", stderr(&output));
        assert!(stderr(&output).contains("film"), "{}", stderr(&output));
    }
    let film = small.out("whole.mp4");
    let mut replay = wad(&["replay", "--record"]);
    let mut child = replay.arg(&film).arg(&kept).stderr(Stdio::piped()).spawn().unwrap();
    let began = Instant::now();
    while std::fs::metadata(&film).map_or(0, |file| file.len()) < 30_000 {
        assert!(began.elapsed() < Duration::from_secs(120) && child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(2));
    }
    // SAFETY: kill() only takes numbers; the process is this test's own child.
    unsafe { libc::kill(child.id() as i32, libc::SIGINT) };
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    assert!(stderr(&output).contains("it ends there"), "{}", stderr(&output));
}

#[cfg(feature = "vision")]
#[test]
fn an_external_agent_drives_and_one_that_fails_costs_its_episode_only() {
    let small = Small::new(25, 2);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/example_agent.py");
    let python = format!("exec:python3 {}", script.display());
    // It answers for a while, then dies: at the same tick in each episode.
    let dying = "exec:echo '{\"image\": true}'; for i in 1 2 3 4 5; do read -r line; test ${#line} -gt 20000 || exit 9; \
                 echo '{\"throttle\": 0.5, \"steer\": 0, \"brake\": 0}'; done; echo out of ideas >&2; exit 3";
    let output = ok(&mut small.eval("run", &["--agent", &python, "--agent", dying]));
    let result = json(&output);
    let [good, bad] = [&result["totals"][0], &result["totals"][1]];
    assert_eq!((good["episodes"].as_u64(), good["agent_failures"].as_u64()), (Some(2), Some(0)), "{good}");
    assert!(good["mean_distance_m"].as_f64() > Some(3.0), "it moves: {good}");
    assert_eq!((bad["episodes"].as_u64(), bad["successes"].as_u64()), (Some(2), Some(0)), "{bad}");
    assert_eq!(bad["agent_failures"], 2, "{bad}");
    let lines = read(&small.out("run").join("episodes.jsonl"));
    assert!(lines.contains("it died (exit status: 3); it said: out of ideas"), "{lines}");
    // Its recorded controls drive where it is not asked again.
    let kept = std::fs::read_dir(small.out("run").join("episodes")).unwrap().next().unwrap().unwrap().path();
    let answer = json(&ok(wad(&["replay", "--verify", "--json"]).arg(kept)));
    assert_eq!((&answer["verify"]["same"], &answer["verify"]["driven"]), (&true.into(), &"recorded".into()));
    assert_eq!(answer["ticks"], 5);

    let out = small.out("drive");
    let mut run =
        wad(&["run", "town3", "--traffic", "empty", "--ticks", "20", "--json", "--agent", &python, "--out"]);
    let summary = json(&ok(run.arg(&out)));
    assert_eq!(summary["ticks"], 20);

    // It is an example worth copying: it arrives in time. Slower in bends, it did not.
    let part =
        ["--condition", "development", "--traffic", "empty", "--weather", "WetSunset", "--episodes", "1"];
    let mut eval = wad(&["eval", "nocrash", "--json", "--agent", &python]);
    assert_eq!(json(&ok(eval.args(part)))["totals"][0]["successes"], 1);
}

/// Neither the names nor the options change here, only what the files hold.
#[test]
fn results_are_not_continued_with_another_scenario_or_detector() {
    let copy = crate::scenario::Copy::of("straight");
    let folder = tempfile::tempdir().unwrap();
    let weights = folder.path().join("detector.onnx");
    std::fs::write(&weights, "some weights").unwrap();
    let (scenario, detector) = (copy.folder.display().to_string(), format!("onnx:{}", weights.display()));
    let eval = || {
        let mut command =
            wad(&["eval", &scenario, "--detector", &detector, "--agent", "constant", "--episodes", "1"]);
        command.arg("--out").arg(folder.path().join("out")).arg("--resume");
        command
    };
    ok(&mut eval());
    ok(&mut eval());
    let refused = |difference: &str| {
        let output = eval().output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains("must not be mixed"), "{}", stderr(&output));
        assert!(stderr(&output).contains(difference), "{}", stderr(&output));
    };
    std::fs::write(&weights, "other weights").unwrap();
    refused("detector: expected");
    std::fs::write(&weights, "some weights").unwrap();
    ok(&mut eval());
    copy.change(
        "add.xml",
        "</additional>",
        "<poi id=\"a\" type=\"bench\" lane=\"NW2A4_0\" pos=\"20\"/></additional>",
    );
    refused("towns.");
}

#[test]
fn found_sets_of_routes_survive_ctrl_c() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("town3.routes.json");
    let sets = ["--set", "straight", "--set", "navigation", "--count", "10"];
    let mut search = wad(&["eval", "routes", "town3", "--out"]);
    search.arg(&out).args(sets).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = search.spawn().unwrap();
    let began = Instant::now();
    // The first set is in the file while the second one is searched.
    while !out.exists() {
        assert!(began.elapsed() < Duration::from_secs(120) && child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(2));
    }
    // SAFETY: kill() only takes numbers; the process is this test's own child.
    unsafe { libc::kill(child.id() as i32, libc::SIGINT) };
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let made = read(&out);
    assert!(made.contains("\"straight\"") && !made.contains("\"navigation\""), "{made}");
}

#[test]
fn mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let failed = |args: &[&str]| {
        let output = wad(args).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
        stderr(&output)
    };
    let error = failed(&["eval", "nocash"]);
    assert!(error.contains("nocash") && error.contains("nocrash"), "{error}");
    assert!(failed(&["eval", "nocrash", "--condition", "newer"]).contains("training, development, test"));
    assert!(failed(&["eval", "composite", "--agent", "wad-x", "--episodes", "1"]).contains("wad-x"));
    assert!(failed(&["eval", "nocrash", "--shard", "3/2"]).contains("K/N"));
    assert!(failed(&["report"]).contains("eval --out"));
    let error = failed(&["report", &folder.path().display().to_string()]);
    assert!(error.contains("config.json"), "{error}");
    let error = failed(&["replay", &folder.path().display().to_string()]);
    assert!(error.contains("episode.json"), "{error}");
    // A net that no routes were made for.
    let towns = wad_cosim::bundled::resolve("town3.net.xml").unwrap();
    let own = folder
        .path()
        .join(format!("own.{}", towns.file_name().unwrap().to_string_lossy().split_once('.').unwrap().1));
    std::fs::copy(&towns, &own).unwrap();
    let own = own.display().to_string();
    let error = failed(&["eval", "nocrash", "--town", &own]);
    assert!(error.contains(&format!("eval routes {own}")), "{error}");
    let made = wad(&["eval", "routes", &own, "--set", "navigation", "--count", "1"]).output().unwrap();
    assert!(made.status.success(), "{}", stderr(&made));
    // Another set joins it in the file.
    let more = ok(wad(&["eval", "routes", &own, "--set", "straight", "--count", "1"]).arg("--json"));
    assert_eq!(json(&more)["routes"], serde_json::json!({ "navigation": 1, "straight": 1 }));
    let args = [
        "eval",
        "nocrash",
        "--town",
        &own,
        "--traffic",
        "empty",
        "--weather",
        "WetNoon",
        "--episodes",
        "1",
        "--json",
    ];
    let result = json(&ok(&mut wad(&args)));
    assert_eq!(
        (&result["rows"][0]["success_rate"], &result["rows"][0]["condition"]),
        (&1.0.into(), &"other".into())
    );
    // The net changes, and its routes are of no use any more.
    let routes = folder.path().join("own.routes.json");
    std::fs::write(&routes, read(&routes).replacen("\"net\": \"", "\"net\": \"0", 1)).unwrap();
    assert!(failed(&args).contains("another net"));
}
