//! `wad-cosim run` from the command line: what it prints, writes and returns.

mod faults;

use super::program::{json, stderr, wad};
use serde_json::Value;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn finish(mut command: Command) -> Output {
    command.output().expect("the binary runs")
}

/// Runs in `dir/name` and returns the summary.
fn run(dir: &Path, name: &str, args: &[&str]) -> (Value, PathBuf) {
    let out = dir.join(name);
    let mut command = wad(&["run"]);
    command.args(args).arg("--json").arg("--out").arg(&out);
    let output = finish(command);
    assert!(output.status.success(), "{:?}: {}", output.status, stderr(&output));
    (json(&output), out)
}

fn telemetry(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("telemetry.jsonl")).expect("telemetry is there")
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
