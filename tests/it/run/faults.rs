//! What a run does when its input is wrong, when SUMO or the agent fails, and when it is told to end.

use super::{finish, run, stderr, sumo_of, telemetry, wad};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

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

/// The program where no file grows beyond so many KiB: like a full disk, once the signal for it is ignored.
fn wad_on_a_full_disk(kib: u32, args: &[&str]) -> Command {
    let script = format!("trap '' XFSZ; ulimit -f {kib}; exec \"$@\"");
    let mut command = Command::new("bash");
    command.args(["-c", &script, "bash", env!("CARGO_BIN_EXE_wad-cosim")]).args(args).stdin(Stdio::null());
    command
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
    let told = super::json(&output);
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
