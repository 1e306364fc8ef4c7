//! `wad-cosim run` from the command line: what it prints, writes and returns, and what it does when
//! things go wrong.

use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn wad(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(args).stdin(Stdio::null());
    command
}

/// The program where no file grows beyond so many KiB: like a full disk, once the signal for it is ignored.
fn wad_on_a_full_disk(kib: u32, args: &[&str]) -> Command {
    let script = format!("trap '' XFSZ; ulimit -f {kib}; exec \"$@\"");
    let mut command = Command::new("bash");
    command.args(["-c", &script, "bash", env!("CARGO_BIN_EXE_wad-cosim")]).args(args).stdin(Stdio::null());
    command
}

fn finish(mut command: Command) -> Output {
    command.output().expect("the binary runs")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn summary(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    let last = text.lines().last().unwrap_or_default();
    serde_json::from_str(last).unwrap_or_else(|e| panic!("{e}: {last:?}\n{}", stderr(output)))
}

/// Runs in `dir/name` and returns the summary.
fn run(dir: &Path, name: &str, args: &[&str]) -> (Value, PathBuf) {
    let out = dir.join(name);
    let mut command = wad(&["run"]);
    command.args(args).arg("--json").arg("--out").arg(&out);
    let output = finish(command);
    assert!(output.status.success(), "{:?}: {}", output.status, stderr(&output));
    (summary(&output), out)
}

fn telemetry(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("telemetry.jsonl")).expect("telemetry is there")
}

/// A run in the background with its SUMO up and some ticks done.
struct Background {
    child: Child,
    out: PathBuf,
    sumo: i32,
}

impl Background {
    fn start(dir: &Path, extra: &[&str]) -> Self {
        let out = dir.join("background");
        let mut command = wad(&["run", "town5", "--traffic", "5,5", "--realtime", "--tick-ms", "20"]);
        command.args(extra).arg("--out").arg(&out).stdout(Stdio::null()).stderr(Stdio::piped());
        // A group of its own, so that a signal to it does not reach the tests.
        command.process_group(0);
        let child = command.spawn().expect("the binary runs");
        let began = Instant::now();
        let sumo = loop {
            let lines = std::fs::metadata(out.join("telemetry.jsonl")).map_or(0, |m| m.len());
            match sumo_of(child.id()) {
                Some(pid) if lines > 0 => break pid,
                _ => assert!(began.elapsed() < Duration::from_secs(60), "the run did not begin"),
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        Self { child, out, sumo }
    }

    fn signal(&self, pid: i32, signal: i32) {
        // SAFETY: kill() only takes numbers; both processes are this test's own.
        let sent = unsafe { libc::kill(pid, signal) };
        assert_eq!(sent, 0);
    }

    fn wait(mut self) -> (std::process::ExitStatus, String, PathBuf) {
        let mut text = String::new();
        if let Some(mut pipe) = self.child.stderr.take() {
            let _ = pipe.read_to_string(&mut text);
        }
        (self.child.wait().expect("it ends"), text, self.out.clone())
    }
}

/// The SUMO child of a process.
pub fn sumo_of(parent: u32) -> Option<i32> {
    std::fs::read_dir("/proc").ok()?.flatten().find_map(|entry| {
        let pid: i32 = entry.file_name().to_str()?.parse().ok()?;
        let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
        let (name, rest) = stat.split_once('(')?.1.rsplit_once(')')?;
        let ppid: u32 = rest.split_whitespace().nth(1)?.parse().ok()?;
        (ppid == parent && name == "sumo").then_some(pid)
    })
}

fn is_gone(pid: i32) -> bool {
    let began = Instant::now();
    while began.elapsed() < Duration::from_secs(10) {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        // Killed and not yet collected counts as gone.
        if stat.is_empty() || stat.rsplit(')').next().is_some_and(|s| s.trim_start().starts_with('Z')) {
            return true;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    false
}

#[test]
fn drives_through_exact_traffic_and_says_so() {
    let dir = tempfile::tempdir().expect("a folder");
    let (s, out) = run(dir.path(), "r", &["nets/town5.sumocfg", "--ticks", "200", "--traffic", "dense"]);
    assert_eq!((s["ticks"].as_u64(), s["end"].as_str()), (Some(200), Some("survived")));
    assert_eq!((s["vehicles_mean"].as_f64(), s["pedestrians_mean"].as_f64()), (Some(70.0), Some(150.0)));
    assert!(s["distance_m"].as_f64() > Some(30.0), "{s}");
    for key in [
        "sim_seconds",
        "wall_seconds",
        "ticks_per_second",
        "mean_speed_mps",
        "destinations_reached",
        "red_lights_run",
        "outside_lane_ticks",
        "seed",
    ] {
        assert!(s[key].is_number(), "{key} is missing in {s}");
    }
    for key in ["collisions", "collisions_caused"] {
        for partner in ["vehicle", "pedestrian", "static"] {
            assert!(s[key][partner].is_u64(), "{key}.{partner} is missing in {s}");
        }
    }
    let text = String::from_utf8(telemetry(&out)).expect("UTF-8");
    assert_eq!(text.lines().count(), 200);
    for line in text.lines() {
        let record: Value = serde_json::from_str(line).expect("each line is JSON");
        assert_eq!(record["vehicles"], 70);
    }
    for file in ["config.json", "summary.json"] {
        let text = std::fs::read_to_string(out.join(file)).expect(file);
        serde_json::from_str::<Value>(&text).expect(file);
    }
}

#[test]
fn same_seed_gives_the_same_bytes_and_another_seed_does_not() {
    let dir = tempfile::tempdir().expect("a folder");
    let args = |seed| ["town5", "--ticks", "250", "--traffic", "dense", "--seed", seed];
    let (_, a) = run(dir.path(), "a", &args("3"));
    let (_, b) = run(dir.path(), "b", &args("3"));
    let (_, c) = run(dir.path(), "c", &args("4"));
    assert!(telemetry(&a) == telemetry(&b), "equal seeds gave different telemetry");
    assert!(telemetry(&a) != telemetry(&c), "different seeds gave equal telemetry");
}

#[test]
fn the_configs_seed_counts_where_no_other_is_given() {
    let dir = tempfile::tempdir().expect("a folder");
    let net = wad_cosim::bundled::resolve("town5.net.xml").expect("a net");
    let config = dir.path().join("own.sumocfg");
    let text =
        format!(r#"<configuration><net-file value="{}"/><seed value="42"/></configuration>"#, net.display());
    std::fs::write(&config, text).expect("written");
    let config = config.to_string_lossy().into_owned();
    let town = [config.as_str(), "--ticks", "3", "--traffic", "2,2"];
    let args = |more: &[&'static str]| [&town, more].concat();
    let (own, a) = run(dir.path(), "own", &args(&[]));
    let (same, b) = run(dir.path(), "same", &args(&["--seed", "42"]));
    let (other, _) = run(dir.path(), "other", &args(&["--seed", "7"]));
    let seeds = [own, same, other].map(|summary| summary["seed"].as_u64());
    assert_eq!(seeds, [Some(42), Some(42), Some(7)]);
    assert!(telemetry(&a) == telemetry(&b), "the same seed gave different telemetry");
}

#[test]
fn several_egos_drive_in_one_sumo_and_each_has_its_lines_and_its_sums() {
    let dir = tempfile::tempdir().expect("a folder");
    let args = ["town3", "--egos", "5", "--ticks", "120", "--traffic", "20,10", "--seed", "3"];
    let (summary, out) = run(dir.path(), "a", &args);
    let (_, again) = run(dir.path(), "b", &args);
    assert!(telemetry(&out) == telemetry(&again), "equal seeds gave different telemetry");
    let lines = String::from_utf8(telemetry(&out)).expect("text");
    let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(lines.len(), 5 * 120);
    let place =
        |line: &Value| [0, 1].map(|axis| line["ego"]["pose"]["position"][axis].as_f64().expect("a place"));
    let egos = summary["egos"].as_array().expect("the egos' own sums");
    let mut sum = 0.0;
    for (index, ego) in egos.iter().enumerate() {
        let own: Vec<&Value> = lines.iter().filter(|line| line["id"] == ego["id"]).collect();
        assert_eq!(own.len(), 120, "{ego}");
        assert_eq!(own[119]["tick"], 120);
        let way = ego["distance_m"].as_f64().expect("a way");
        assert!(way > 5.0, "the autopilot drives each: {ego}");
        sum += way;
        for other in &lines[..index] {
            let ([x, y], [there_x, there_y]) = (place(&lines[index]), place(other));
            assert!((x - there_x).hypot(y - there_y) > 20.0, "they begin apart");
        }
    }
    assert_eq!(egos.len(), 5);
    assert!((summary["distance_m"].as_f64().expect("a way") - sum).abs() < 1e-6);
    assert_eq!(summary["ticks"], 120);
}

#[test]
fn wrong_input_is_refused_with_exit_code_2_and_a_reason() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = |name: &str, text: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, text).expect("written");
        path.to_string_lossy().into_owned()
    };
    let not_xml = file("a.sumocfg", "this is no XML");
    let no_net = file("b.sumocfg", r#"<configuration><net-file value="gone.net.xml"/></configuration>"#);
    let empty = file(
        "empty.net.xml",
        r#"<net version="1.20"><location netOffset="0,0" convBoundary="0,0,9,9" origBoundary="0,0,9,9" projParameter="!"/></net>"#,
    );
    let cases: [(&[&str], &str); 10] = [
        (&["atlantis"], "atlantis"),
        (&["town5", "--egos", "200", "--traffic", "empty"], "has room for"),
        (&[&not_xml], "not a SUMO configuration"),
        (&[&no_net], "gone.net.xml"),
        (&[&empty], "no drivable lane"),
        (&["town5", "--route", "nowhere,elsewhere"], "nowhere"),
        (&["town5", "--route", "-1"], "FROM,TO"),
        (&["town5", "--traffic", "heavy"], "as-is, empty, regular, dense"),
        (&["town5", "--tick-ms", "0"], "1 to 1000 ms"),
        (&["leader_brakes", "--egos", "2"], "a scenario has one ego, found 2"),
    ];
    for (i, (args, reason)) in cases.iter().enumerate() {
        let mut command = wad(&["run"]);
        command.args(*args).args(["--ticks", "5", "--out"]).arg(dir.path().join(format!("out{i}")));
        let output = finish(command);
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        assert!(text.contains(reason), "{args:?} should say {reason:?}: {text}");
        let out = dir.path().join(format!("out{i}"));
        assert!(!out.exists(), "{args:?} leaves a folder that refuses the next run");
    }
}

#[test]
fn a_finished_run_is_not_overwritten() {
    let dir = tempfile::tempdir().expect("a folder");
    let args = ["town5", "--ticks", "5", "--traffic", "empty"];
    let (_, out) = run(dir.path(), "r", &args);
    let before = telemetry(&out);
    let mut command = wad(&["run"]);
    command.args(args).arg("--out").arg(&out);
    let output = finish(command);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("already holds a run"), "{}", stderr(&output));
    assert!(before == telemetry(&out));
}

#[test]
fn a_missing_sumo_is_exit_code_3_and_says_what_to_do() {
    let dir = tempfile::tempdir().expect("a folder");
    let out = dir.path().join("r").to_string_lossy().into_owned();
    for args in [
        &["run", "town5", "--ticks", "5", "--out", &out][..],
        &["eval", "nocrash", "--episodes", "1"],
        &["dataset", "collect", "--frames", "1", "--out", &out],
        &["bench", "fleet"],
    ] {
        let mut command = wad(args);
        command.env("WAD_COSIM_SUMO_HOME", dir.path().join("nothing"));
        let output = finish(command);
        assert_eq!(output.status.code(), Some(3), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains("scripts/setup"), "{args:?}: {}", stderr(&output));
    }
}

#[test]
fn a_sumo_that_is_too_old_is_exit_code_3_and_says_which_is_needed() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().expect("a folder");
    let program = dir.path().join("bin/sumo");
    std::fs::create_dir(dir.path().join("bin")).expect("a folder");
    std::fs::write(&program, "#!/bin/sh\necho 'Eclipse SUMO sumo Version 1.15.0'\n").expect("a script");
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).expect("executable");
    let out = dir.path().join("r");
    let mut command = wad(&["run", "town5", "--ticks", "5", "--out"]);
    command.arg(&out).env("WAD_COSIM_SUMO_HOME", dir.path());
    let output = finish(command);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    for part in ["1.15.0", "1.28.0 or newer", "scripts/setup"] {
        assert!(stderr(&output).contains(part), "{}", stderr(&output));
    }
}

#[test]
fn a_killed_sumo_ends_the_run_with_exit_code_3_and_its_last_log_lines() {
    let dir = tempfile::tempdir().expect("a folder");
    let background = Background::start(dir.path(), &[]);
    background.signal(background.sumo, libc::SIGKILL);
    let (status, text, out) = background.wait();
    assert_eq!(status.code(), Some(3), "{text}");
    assert!(text.contains("signal: 9") && text.contains("sumo.log"), "{text}");
    let telemetry = String::from_utf8(telemetry(&out)).expect("UTF-8");
    assert!(telemetry.lines().all(|line| serde_json::from_str::<Value>(line).is_ok()));
    let summary = std::fs::read_to_string(out.join("summary.json")).expect("a summary");
    assert!(summary.contains(r#""end": "error""#), "{summary}");
}

#[test]
fn a_sumo_that_hangs_is_given_up_and_killed() {
    let dir = tempfile::tempdir().expect("a folder");
    let background = Background::start(dir.path(), &["--tick-timeout", "1"]);
    let sumo = background.sumo;
    background.signal(sumo, libc::SIGSTOP);
    let (status, text, _) = background.wait();
    assert_eq!(status.code(), Some(3), "{text}");
    assert!(text.contains("hangs"), "{text}");
    assert!(is_gone(sumo), "the hanging SUMO was left behind");
}

#[test]
fn sumo_dies_with_us_even_when_we_are_killed() {
    let dir = tempfile::tempdir().expect("a folder");
    let background = Background::start(dir.path(), &[]);
    let sumo = background.sumo;
    background.signal(background.child.id() as i32, libc::SIGKILL);
    let (status, _, out) = background.wait();
    assert_eq!(status.signal(), Some(libc::SIGKILL));
    assert!(is_gone(sumo), "SUMO outlived us");
    let telemetry = String::from_utf8(telemetry(&out)).expect("UTF-8");
    let whole = telemetry.lines().filter(|line| serde_json::from_str::<Value>(line).is_ok()).count();
    assert!(whole + 1 >= telemetry.lines().count(), "more than the last line is torn");
}

/// An agent that leaves a process in a session of its own, and writes that process's number to `file`.
#[cfg(feature = "vision")]
fn agent_with_a_daemon(file: &Path, then: &str) -> String {
    format!("exec:setsid sleep 1000 & echo $! >{}; echo '{{}}'; {then}", file.display())
}

#[cfg(feature = "vision")]
#[test]
fn external_agents_die_with_us_even_by_sigkill() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("pid");
    let drive = r#"while read -r line; do echo '{"throttle": 0.2, "steer": 0, "brake": 0}'; done"#;
    let background = Background::start(dir.path(), &["--agent", &agent_with_a_daemon(&file, drive)]);
    let daemon: i32 = std::fs::read_to_string(&file).expect("a number").trim().parse().expect("a number");
    assert!(Path::new(&format!("/proc/{daemon}")).exists());
    background.signal(background.child.id() as i32, libc::SIGKILL);
    background.wait();
    assert!(is_gone(daemon), "the agent's process outlived us");
}

#[cfg(feature = "vision")]
#[test]
fn ctrl_c_is_answered_at_once_and_the_second_ends_with_4() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("pid");
    // It hangs, and would for ten minutes.
    let agent = agent_with_a_daemon(&file, "sleep 1000");
    let mut command = wad(&["eval", "straight", "--agent-timeout", "600", "--agent", &agent]);
    command.process_group(0).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the binary runs");
    let began = Instant::now();
    let daemon: i32 = loop {
        if let Ok(Ok(pid)) = std::fs::read_to_string(&file).map(|text| text.trim().parse()) {
            break pid;
        }
        assert!(began.elapsed() < Duration::from_secs(120), "the agent did not start");
        std::thread::sleep(Duration::from_millis(20));
    };
    let group = -(child.id() as i32);
    // SAFETY: kill() only takes numbers; the process is this test's own.
    let interrupt = || assert_eq!(unsafe { libc::kill(group, libc::SIGINT) }, 0);
    interrupt();
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stderr.take().expect("a pipe")));
    assert!(lines.any(|line| line.expect("UTF-8").contains("once more ends at once")));
    interrupt();
    let status = child.wait().expect("it ends");
    assert_eq!(status.code(), Some(4), "{status}");
    assert!(is_gone(daemon), "the agent's process outlived us");
}

#[test]
fn ctrl_c_keeps_the_results() {
    let dir = tempfile::tempdir().expect("a folder");
    let background = Background::start(dir.path(), &[]);
    let sumo = background.sumo;
    // To the whole group, as a terminal does.
    background.signal(-(background.child.id() as i32), libc::SIGINT);
    let (status, text, out) = background.wait();
    assert_eq!(status.code(), Some(4), "{text}");
    assert!(!text.contains("did not close properly"), "{text}");
    assert!(is_gone(sumo));
    let summary: Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).expect("a summary"))
            .expect("JSON");
    assert_eq!(summary["interrupted"], true);
    let lines = telemetry(&out).iter().filter(|&&b| b == b'\n').count() as u64;
    assert_eq!(summary["ticks"].as_u64(), Some(lines));
}

#[test]
fn ctrl_c_ends_the_benchmark_of_the_view_with_4() {
    let sizes = ["--viewers", "1", "--ticks", "2", "--tick-ms", "20", "--repeat", "10000"];
    let mut command = wad(&["bench", "view", "--detector", "truth"]);
    command.args(sizes).process_group(0).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the binary runs");
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stderr.take().expect("a pipe")));
    assert!(lines.any(|line| line.expect("UTF-8").starts_with("turn ")));
    // SAFETY: kill() only takes numbers; the process is this test's own.
    let sent = unsafe { libc::kill(child.id() as i32, libc::SIGINT) };
    assert_eq!(sent, 0);
    assert_eq!(child.wait().expect("it ends").code(), Some(4));
}

#[test]
fn a_stderr_that_cannot_be_written_stops_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
    let code = |mut command: Command| command.stderr(full()).status().unwrap().code();
    let mut drive = wad(&["-vv", "run", "town5", "--traffic", "empty", "--ticks", "3", "--json", "--out"]);
    drive.arg(dir.path().join("run")).stdout(Stdio::null());
    assert_eq!(code(drive), Some(0));
    assert_eq!(code(wad(&["run", "no-such-town"])), Some(2));
    // Results that cannot be written are another matter.
    let mut list = wad(&["scenario", "list"]);
    list.stdout(full());
    assert_eq!(code(list), Some(1));
}

#[test]
fn a_full_disk_is_said_and_what_was_written_stays() {
    let dir = tempfile::tempdir().expect("a folder");
    let out = dir.path().join("r");
    let mut command =
        wad_on_a_full_disk(128, &["run", "town5", "--traffic", "3,3", "--ticks", "2000", "--out"]);
    command.arg(&out);
    let output = finish(command);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("telemetry.jsonl") && text.contains("stays readable"), "{text}");
    let telemetry = String::from_utf8(telemetry(&out)).expect("UTF-8");
    let whole = telemetry.lines().filter(|line| serde_json::from_str::<Value>(line).is_ok()).count();
    assert!(whole > 50 && whole + 1 >= telemetry.lines().count(), "{whole} whole lines");
}

#[test]
fn a_film_that_cannot_be_written_ends_the_run_with_a_summary() {
    let dir = tempfile::tempdir().expect("a folder");
    let out = dir.path().join("r");
    // A picture is larger, and what SUMO and the run write in a tick is not.
    let mut command =
        wad_on_a_full_disk(128, &["run", "town5", "--traffic", "3,3", "--ticks", "20", "--record"]);
    command.arg(dir.path().join("film/")).arg("--out").arg(&out);
    let output = finish(command);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("frame-000000.png"), "{}", stderr(&output));
    let summary = std::fs::read_to_string(out.join("summary.json")).expect("a summary");
    assert!(summary.contains(r#""end": "error""#), "{summary}");
}

/// OpenCV does not say before its end that a film lacks pictures.
#[cfg(feature = "vision")]
#[test]
fn a_film_that_is_cut_off_costs_the_run_nothing() {
    let dir = tempfile::tempdir().expect("a folder");
    let out = dir.path().join("r");
    let args = ["run", "town5", "--traffic", "empty", "--ticks", "40", "--json", "--record"];
    let mut command = wad_on_a_full_disk(64, &args);
    command.arg(dir.path().join("film.mp4")).arg("--out").arg(&out);
    let output = finish(command);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("Is the disk full?"), "{}", stderr(&output));
    let told = summary(&output);
    assert_eq!((told["ticks"].as_u64(), told["end"].as_str()), (Some(40), Some("survived")));
    assert!(out.join("summary.json").is_file());
}

/// A TraCI server that answers the first message with `reply`.
fn fake_server(reply: Vec<u8>) -> (String, std::thread::JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address").to_string();
    let server = std::thread::spawn(move || {
        let Ok((mut stream, _)) = listener.accept() else { return };
        let mut length = [0; 4];
        if stream.read_exact(&mut length).is_ok() {
            let _ = stream.write_all(&reply);
            std::thread::sleep(Duration::from_millis(200));
        }
    });
    (address, server)
}

#[test]
fn a_server_of_a_wrong_version_or_with_garbage_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    // Status of "get version" (length 7, command 0, result 0, empty text), then the version reply:
    // length, command, API number, name.
    let mut old = vec![0, 0, 0, 26, 7, 0, 0, 0, 0, 0, 0, 15, 0, 0, 0, 0, 3, 0, 0, 0, 5];
    old.extend_from_slice(b"SUMO9");
    let cases = [(old, "version 3"), (b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec(), "TraCI")];
    for (i, (reply, reason)) in cases.into_iter().enumerate() {
        let (address, server) = fake_server(reply);
        let mut command = wad(&["run", "town5", "--ticks", "5", "--attach", &address, "--out"]);
        command.arg(dir.path().join(format!("r{i}"))).args(["--tick-timeout", "5"]);
        let output = finish(command);
        assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
        assert!(stderr(&output).contains(reason), "{}", stderr(&output));
        server.join().expect("the server ends");
    }
}

#[test]
fn joins_a_running_sumo() {
    let dir = tempfile::tempdir().expect("a folder");
    let (_, made) = run(dir.path(), "first", &["town5", "--ticks", "1", "--traffic", "empty"]);
    let install = wad_cosim::traci::process::SumoInstall::find().expect("SUMO");
    let port = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("a port").port();
    let mut sumo = install
        .command("sumo")
        .arg("-c")
        .arg(made.join("sumo/sumo.sumocfg"))
        .args(["--remote-port", &port.to_string()])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("SUMO starts");
    // A connection would be the one that it accepts: that the port is taken must do as a sign.
    let began = Instant::now();
    while TcpListener::bind(("0.0.0.0", port)).is_ok() {
        assert!(began.elapsed() < Duration::from_secs(30), "SUMO does not listen");
        std::thread::sleep(Duration::from_millis(50));
    }
    let address = format!("127.0.0.1:{port}");
    let (s, _) =
        run(dir.path(), "joined", &["town5", "--ticks", "50", "--attach", &address, "--traffic", "10,10"]);
    assert_eq!(s["ticks"], 50);
    assert_eq!(s["vehicles_mean"].as_f64(), Some(10.0));
    let _ = sumo.kill();
    let _ = sumo.wait();
}

#[test]
fn runs_untouched_on_the_nets_that_ship_with_sumo() {
    let dir = tempfile::tempdir().expect("a folder");
    let install = wad_cosim::traci::process::SumoInstall::find().expect("SUMO");
    for name in ["A10KW", "square", "fokr_bs_demo", "grid6"] {
        let config = install.home().join(format!("tools/game/{name}.sumocfg"));
        let config = config.to_string_lossy().into_owned();
        let before = folder_listing(&install.home().join("tools/game"));
        let (s, _) = run(dir.path(), name, &[&config, "--ticks", "150"]);
        assert_eq!(s["ticks"], 150, "{name}");
        assert!(s["distance_m"].as_f64() > Some(5.0), "{name}: {s}");
        assert_eq!(
            before,
            folder_listing(&install.home().join("tools/game")),
            "{name} wrote beside its config"
        );
    }
}

fn folder_listing(dir: &Path) -> Vec<PathBuf> {
    let mut names: Vec<PathBuf> =
        std::fs::read_dir(dir).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    names.sort();
    names
}

#[test]
fn edge_ids_may_begin_with_a_minus() {
    let dir = tempfile::tempdir().expect("a folder");
    let install = wad_cosim::traci::process::SumoInstall::find().expect("SUMO");
    let net = dir.path().join("n.net.xml");
    let nodes = dir.path().join("n.nod.xml");
    let edges = dir.path().join("n.edg.xml");
    std::fs::write(&nodes, r#"<nodes><node id="a" x="0" y="0"/><node id="b" x="200" y="0"/><node id="c" x="400" y="50"/></nodes>"#)
        .expect("written");
    std::fs::write(
        &edges,
        r#"<edges><edge id="-10.0.00" from="a" to="b"/><edge id="-3" from="b" to="c"/><edge id="3" from="c" to="b"/><edge id="10.0.00" from="b" to="a"/></edges>"#,
    )
    .expect("written");
    let built = install
        .command("netconvert")
        .arg("-n")
        .arg(&nodes)
        .arg("-e")
        .arg(&edges)
        .arg("-o")
        .arg(&net)
        .output()
        .expect("netconvert runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let net = net.to_string_lossy().into_owned();
    let (s, out) = run(dir.path(), "r", &[&net, "--route", "-10.0.00,-3", "--ticks", "40"]);
    assert!(s["distance_m"].as_f64() > Some(10.0), "{s}");
    let first = String::from_utf8(telemetry(&out)).expect("UTF-8");
    assert!(first.lines().next().is_some_and(|line| line.contains("-10.0.00_0")));
}
