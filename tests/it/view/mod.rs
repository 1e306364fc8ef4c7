//! The live view: `run --view` from outside, as a browser and as those who should not be let in.

mod browser;
mod viewer;

use browser::{Browser, Page};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message};
use viewer::{Viewed, Viewer, request, run_in};

#[test]
fn connections_that_never_ask_keep_no_viewer_out() {
    let dir = tempfile::tempdir().expect("a folder");
    let viewed = run_in(dir.path(), &[]);
    Viewer::join(&viewed.address);
    let files = || std::fs::read_dir(format!("/proc/{}/fd", viewed.child.id())).expect("its files").count();
    let before = files();
    let half_open: Vec<TcpStream> = (0..300)
        .map(|_| {
            let mut stream = TcpStream::connect(&viewed.address).expect("it listens");
            stream.write_all(b"GET / HTTP/1.1\r\nHost: ").expect("it reads");
            stream
        })
        .collect();
    assert!(request(&viewed.address, "/", &format!("Host: {}\r\n", viewed.address)).contains("200"));
    Viewer::join(&viewed.address).tick();
    assert!(files() < before + 100, "{} files for {before}", files());
    // All are closed in the end, without a word from us.
    for mut stream in half_open {
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a limit");
        let ended = stream.read_to_end(&mut Vec::new());
        let closed = |e: &std::io::Error| e.kind() == std::io::ErrorKind::ConnectionReset;
        assert!(ended.as_ref().is_ok() || ended.as_ref().is_err_and(closed), "{ended:?}");
    }
    assert_eq!(viewed.stop(), Some(4));
}

#[test]
fn who_does_not_belong_is_refused_and_the_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path(), &["--view-speed", "4"]);
    let mut viewer = Viewer::join(&run.address);
    let (first, pictures) = viewer.tick();
    assert!(pictures.starts_with(&[0xff, 0xd8]), "no JPEG");

    let own = format!("Host: {}\r\n", run.address);
    assert!(request(&run.address, "/", &own).contains("200"));
    assert!(request(&run.address, "/map.json", "Host: evil.example\r\n").contains("403"));
    assert!(request(&run.address, "/", &format!("{own}Origin: http://evil.example\r\n")).contains("403"));
    assert!(request(&run.address, "/../Cargo.toml", &own).contains("404"));
    let mut cross = format!("ws://{}/ws", run.address).into_client_request().unwrap();
    cross.headers_mut().insert("Origin", "http://evil.example".parse().unwrap());
    let refused = viewer.runtime.block_on(tokio_tungstenite::connect_async(cross));
    assert!(matches!(refused, Err(Error::Http(answer)) if answer.status() == 403));

    // What cannot be read is refused with a word, too much of it ends the connection.
    let mut wrong = Viewer::join(&run.address);
    wrong.send_raw(Message::text("{\"do\":\"fly\"}"));
    let answer = loop {
        if let Some(Ok(Message::Text(text))) = wrong.receive()
            && text.contains("refused")
        {
            break text;
        }
    };
    assert!(answer.contains("fly"), "{answer}");
    for _ in 0..30 {
        wrong.send_raw(Message::text("nonsense"));
    }
    assert!(wrong.is_sent_away());
    let mut long = Viewer::join(&run.address);
    long.send_raw(Message::text("x".repeat(1 << 16)));
    assert!(long.is_sent_away());
    let mut many = Viewer::join(&run.address);
    for _ in 0..2000 {
        many.send(json!({ "do": "look", "chase": false, "stages": false }));
    }
    assert!(many.is_sent_away());

    let tick = first["tick"].as_u64().unwrap();
    viewer.until("further on", |state| state["tick"].as_u64().unwrap() > tick + 10);
    assert_eq!(viewer.until("alone", |state| state["viewers"] == 1)["paused"], false);

    // Another run on the same port says so, and offers one that is free.
    let busy = Command::new(env!("CARGO_BIN_EXE_wad-cosim"))
        .args(["run", "town5", "--view", &run.address, "--out"])
        .arg(folder.path().join("other"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&busy.stderr);
    assert_eq!(busy.status.code(), Some(2), "{said}");
    assert!(said.contains("in use") && said.contains("--view 127.0.0.1:"), "{said}");
    assert_eq!(run.stop(), Some(4));
}

#[test]
fn any_of_several_egos_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path(), &["--view-speed", "2", "--egos", "3"]);
    let mut viewer = Viewer::join(&run.address);
    let place = |state: &Value| ["x", "y"].map(|axis| state["ego"][axis].as_f64().unwrap());
    let (first, _) = viewer.tick();
    assert_eq!((first["followed"].as_u64(), first["egos"].as_array().map(Vec::len)), (Some(0), Some(3)));
    viewer.send(json!({ "do": "pause", "on": true }));
    for ego in [2, 1, 0] {
        viewer.send(json!({ "do": "follow", "ego": ego }));
        let state =
            viewer.until("the other ego", |state| state["followed"] == ego && state["paused"] == true);
        let shown = &state["egos"][ego as usize];
        assert_eq!(place(&state), [0, 1].map(|axis| shown[axis].as_f64().unwrap()), "{state}");
    }
    // Who drives goes along with the ego: the wheel is given back first.
    viewer.send(json!({ "do": "driver", "name": "manual" }));
    let own = viewer.hello["you"].clone();
    viewer.until("at the wheel", |state| state["holder"] == own);
    viewer.send(json!({ "do": "follow", "ego": 1 }));
    let state = viewer.until("followed", |state| state["followed"] == 1);
    assert!(state["holder"].is_null() && state["driver"] == "autopilot", "{state}");
    viewer.send(json!({ "do": "follow", "ego": 7 }));
    viewer.until("refused", |state| state["notes"].to_string().contains("there is no ego 8"));
    assert_eq!(run.stop(), Some(4));
}

#[test]
fn a_person_drives_goes_and_the_drive_can_be_driven_again() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path(), &["--view-speed", "2"]);
    let (mut other, mut viewer) = (Viewer::join(&run.address), Viewer::join(&run.address));
    viewer.tick();
    viewer.send(json!({ "do": "driver", "name": "manual" }));
    let own = viewer.hello["you"].clone();
    viewer.until("at the wheel", |state| state["holder"] == own);
    // What is wanted before a tick is in that tick, and rises as a foot presses.
    viewer.send(json!({ "do": "pause", "on": true }));
    let still = viewer.until("paused", |state| state["paused"] == true);
    viewer.drive(0.0, 1.0);
    viewer.send(json!({ "do": "step" }));
    let next = viewer.until("a tick", |state| state["tick"].as_u64() > still["tick"].as_u64());
    assert_eq!(next["tick"].as_u64().unwrap(), still["tick"].as_u64().unwrap() + 1);
    let throttle = |state: &Value| state["control"]["throttle"].as_f64().unwrap();
    let pressed = throttle(&next) - throttle(&still);
    assert!(throttle(&next) == 1.0 || pressed > 0.2, "{pressed}");
    viewer.send(json!({ "do": "pause", "on": false }));
    // Another viewer may not take the wheel away.
    other.send(json!({ "do": "driver", "name": "manual" }));
    let began = viewer.tick().0;
    let mut end = began.clone();
    while end["time"].as_f64().unwrap() < began["time"].as_f64().unwrap() + 4.0 {
        viewer.drive(0.0, 0.7);
        end = viewer.tick().0;
    }
    let place = |state: &Value| (state["ego"]["x"].as_f64().unwrap(), state["ego"]["y"].as_f64().unwrap());
    let ((x, y), (to_x, to_y)) = (place(&still), place(&end));
    let way = (to_x - x).hypot(to_y - y);
    assert!(way > 3.0, "{way}");

    assert!(end["holder"] == own && end["notes"].to_string().contains("asks for manual"), "{end}");

    // Reverse gear engages once the ego stands.
    let began = Instant::now();
    let speed = |state: &Value| state["ego"]["speed"].as_f64().unwrap();
    while speed(&end) > -1.0 && began.elapsed() < Duration::from_secs(60) {
        let (throttle, brake) = if speed(&end) > 0.5 { (0.0, 0.7) } else { (0.6, 0.0) };
        viewer.send(
            json!({ "do": "drive", "steer": 0, "throttle": throttle, "brake": brake, "reverse": true }),
        );
        end = viewer.tick().0;
    }
    assert!(speed(&end) <= -1.0 && end["control"]["reverse"] == true, "{end}");

    // When the driver has gone, the autopilot has it at once.
    drop(viewer);
    let gone = Instant::now();
    other.until("the autopilot's", |state| state["driver"] == "autopilot");
    assert!(gone.elapsed() < Duration::from_millis(2500), "{:?}", gone.elapsed());
    assert!(run.said("the autopilot takes over"));

    // Wishes are part of the drive.
    other.send(json!({ "do": "respawn" }));
    other.send(json!({ "do": "traffic", "vehicles": 12, "pedestrians": 4 }));
    let state = other.until("moved to another place", |state| {
        state["notes"].to_string().contains("moved to another place")
    });
    let tick = state["tick"].as_u64().unwrap();
    other.send(json!({ "do": "new_route" }));
    other.until("a few ticks on", |state| state["tick"].as_u64().unwrap() > tick + 12);
    assert_eq!(run.stop(), Some(4));
    let telemetry = std::fs::read_to_string(folder.path().join("run/telemetry.jsonl")).unwrap();
    assert!(telemetry.contains(r#""driver":"manual""#) && telemetry.contains(r#""wish":"respawn""#));
    collect_again(folder.path());
}

#[test]
fn who_drove_before_gets_the_wheel_back() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path(), &["--view-speed", "2", "--agent", "constant"]);
    let mut viewer = Viewer::join(&run.address);
    assert_eq!(viewer.tick().0["driver"], "constant");
    let mut browser = Browser::start();
    let page = browser.open(&run.url(), (1366, 768));
    browser.wait(&page, "window.wad && wad.state");
    let press = |browser: &mut Browser, key: &str, code: &str| {
        browser.key(&page, key, code, true);
        browser.key(&page, key, code, false);
    };
    press(&mut browser, "m", "KeyM");
    let state = viewer.until("at the wheel", |state| state["driver"] == "manual");
    assert_eq!(state["before"], "constant");
    browser.wait(&page, "wad.state.before === 'constant' && wad.state.holder === wad.hello.you");
    press(&mut browser, "m", "KeyM");
    viewer.until("the driver of before", |state| state["driver"] == "constant");
    // The arrow keys choose among the drivers, and Tab reaches one of them.
    let stops = "[...document.querySelectorAll('#drivers button')].filter((b) => b.tabIndex === 0)";
    browser.wait(&page, &format!("{stops}.length === 1 && {stops}[0].dataset.name === 'constant'"));
    browser.ask(&page, &format!("{stops}[0].focus()"));
    press(&mut browser, "ArrowRight", "ArrowRight");
    viewer.until("the next driver", |state| state["driver"] == "random");
    // A viewer's autopilot says why it drives so, as the run's own does.
    viewer.send(json!({ "do": "driver", "name": "autopilot" }));
    viewer.until("the reason", |state| state["driver"] == "autopilot" && state["reason"].is_string());
    assert_eq!(browser.complaints, Vec::<String>::new());
    assert_eq!(run.stop(), Some(4));
}

/// SUMO hangs, so no tick comes: the server says that it is there, and that a silent viewer has lost the wheel.
#[test]
fn who_has_the_wheel_is_said_while_the_simulation_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path(), &[]);
    let mut viewer = Viewer::join(&run.address);
    viewer.tick();
    viewer.send(json!({ "do": "driver", "name": "manual" }));
    let own = viewer.hello["you"].clone();
    viewer.until("at the wheel", |state| state["holder"] == own);
    viewer.drive(0.0, 0.0);
    viewer.until_holder(&own);
    let sumo = crate::run::sumo_of(run.child.id()).expect("a SUMO");
    // SAFETY: kill() only takes numbers; the process is this test's own.
    let signal = |signal| assert_eq!(unsafe { libc::kill(sumo, signal) }, 0);
    signal(libc::SIGSTOP);
    viewer.until_holder(&Value::Null);
    signal(libc::SIGCONT);
    viewer.until("the autopilot's", |state| state["holder"].is_null() && state["driver"] == "autopilot");
    assert_eq!(run.stop(), Some(4));
}

/// `dataset collect` drives the run again, and finds the ego where the run says.
#[cfg(feature = "vision")]
fn collect_again(folder: &Path) {
    let collected = Command::new(env!("CARGO_BIN_EXE_wad-cosim"))
        .args(["dataset", "collect", "--weather", "ClearNoon", "--json", "--from"])
        .arg(folder.join("run"))
        .arg("--out")
        .arg(folder.join("data"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&collected.stderr);
    assert!(collected.status.success(), "{said}");
    let report: Value = serde_json::from_slice(&collected.stdout).unwrap();
    assert!(report["frames"].as_u64().unwrap() > 3, "{report}");
}

#[cfg(not(feature = "vision"))]
fn collect_again(_: &Path) {}

#[test]
fn beyond_this_machine_a_token_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let said = |extra: &[&str]| {
        let run = Command::new(env!("CARGO_BIN_EXE_wad-cosim"))
            .args(["run", "town5", "--view", "0.0.0.0:0", "--ticks", "1", "--out"])
            .arg(folder.path().join("run"))
            .args(extra)
            .output()
            .unwrap();
        (run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned())
    };
    let (code, text) = said(&[]);
    assert!(code == Some(2) && text.contains("--view-token"), "{text}");
    let (code, text) = said(&["--view-token", "short"]);
    assert!(code == Some(2) && text.contains("8 characters"), "{text}");

    let out = folder.path().join("run").display().to_string();
    let args = ["run", "town5", "--traffic", "empty", "--out", &out, "--view-token", "let-me-in"];
    let run = Viewed::start(&args);
    let (address, query) = run.address.split_once("/?").expect("the token in the address");
    let mut viewer = Viewer::join_at(&format!("ws://{address}/ws?{query}"));
    viewer.tick();
    let own = format!("Host: {address}\r\n");
    assert!(
        request(address, "/", &own).contains("403")
            && request(address, "/map.json?token=", &own).contains("403")
    );
    assert!(request(address, &format!("/?{query}"), &own).contains("200"));
}

#[test]
fn the_page_in_a_browser() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path(), &["--view-speed", "2"]);
    drop(Viewer::join(&run.address));
    let mut browser = Browser::start();
    let page = browser.open(&run.url(), (1366, 768));
    browser.wait(&page, "window.wad && wad.frames > 3");
    let shown = "(() => { const t = document.createElement('canvas'); t.width = t.height = 64; \
                 const c = t.getContext('2d', { willReadFrequently: true }); \
                 c.drawImage(document.getElementById('camera'), 0, 0, 64, 64); \
                 return c.getImageData(0, 0, 64, 64).data.reduce((h, v) => (h * 31 + v) | 0, 0); })()";
    let pixels = browser.ask(&page, shown);
    browser.wait(&page, &format!("{shown} !== {pixels}"));

    // Pause holds the clock, a step moves it by one.
    browser.key(&page, "p", "KeyP", true);
    browser.key(&page, "p", "KeyP", false);
    browser.wait(&page, "wad.state.paused");
    let tick = browser.ask(&page, "wad.state.tick").as_u64().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(browser.ask(&page, "wad.state.tick"), tick);
    browser.ask(&page, "document.getElementById('step').click()");
    browser.wait(&page, &format!("wad.state.tick === {}", tick + 1));

    // Two viewers agree.
    let second = browser.open(&run.url(), (390, 844));
    browser.wait(&second, "window.wad && wad.state");
    let place = "[wad.state.tick, wad.state.ego.x, wad.state.ego.y, wad.state.sums.join()].join()";
    assert_eq!(browser.ask(&page, place), browser.ask(&second, place));
    browser.close(&second);
    browser.ask(&page, "document.getElementById('pause').click()");
    browser.wait(&page, "!wad.state.paused");

    // Keys drive the ego for ten simulated seconds, from a place where nobody stands in its way.
    browser.ask(&page, "document.getElementById('respawn').click()");
    browser.wait(&page, "document.getElementById('events').textContent.includes('moved to another place')");
    let before = browser.ask(&page, "[wad.state.ego.x, wad.state.ego.y, wad.state.time]");
    let until = before[2].as_f64().unwrap() + 10.0;
    drive_until(&mut browser, &page, "wad.state.control.throttle > 0.5");
    drive_until(&mut browser, &page, &format!("wad.state.time > {until}"));
    browser.key(&page, "ArrowUp", "ArrowUp", false);
    let after = browser.ask(&page, "[wad.state.ego.x, wad.state.ego.y]");
    let way = |i: usize| after[i].as_f64().unwrap() - before[i].as_f64().unwrap();
    assert!(way(0).hypot(way(1)) > 10.0, "{before} {after}");
    browser.ask(&page, "document.querySelector('[data-name=autopilot]').click()");
    browser.wait(&page, "wad.state.driver === 'autopilot'");

    // A page that is loaded again is there again.
    browser.reload(&page);
    browser.wait(
        &page,
        "window.wad && wad.frames > 2 && document.getElementById('link').textContent === 'live'",
    );
    let mut latencies: Vec<f64> =
        serde_json::from_value(browser.ask(&page, "wad.latencies")).expect("numbers of ms");
    latencies.sort_by(f64::total_cmp);
    eprintln!("tick to pixels: median {:.0} ms", latencies[latencies.len() / 2]);
    assert_eq!(browser.complaints, Vec::<String>::new());
    assert_eq!(run.stop(), Some(4));
}

/// Takes the wheel and holds the throttle until an expression is true, as a person would: a keyboard repeats a key that is held,
/// and who was not heard for 0.8 s, as a browser on a busy machine, takes the wheel again.
fn drive_until(browser: &mut Browser, page: &Page, expression: &str) {
    for _ in 0..600 {
        if browser.ask(page, "document.body.classList.contains('driving')") != true {
            browser.key(page, "m", "KeyM", true);
            browser.key(page, "m", "KeyM", false);
            browser.wait(page, "document.body.classList.contains('driving')");
        }
        browser.key(page, "ArrowUp", "ArrowUp", true);
        if browser.ask(page, &format!("Boolean({expression})")) == true {
            return;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    panic!("never true: {expression}");
}

/// A crash of a driver who only accelerates, as `eval` keeps it.
#[cfg(feature = "vision")]
fn kept_crashes(folder: &Path) -> String {
    let out = folder.join("eval");
    let evaluated = Command::new(env!("CARGO_BIN_EXE_wad-cosim"))
        .args(["eval", "tasks", "--agent", "constant:1,0,0", "--town", "town5", "--task", "one_turn"])
        .args(["--weather", "WetCloudySunset", "--episodes", "2", "--out"])
        .arg(&out)
        .output()
        .unwrap();
    assert!(evaluated.status.success(), "{}", String::from_utf8_lossy(&evaluated.stderr));
    out.display().to_string()
}

#[cfg(feature = "vision")]
#[test]
fn a_kept_episode_is_played_and_scrubbed_in_a_browser() {
    let folder = tempfile::tempdir().unwrap();
    let kept = kept_crashes(folder.path());
    let replay = Viewed::start(&["replay", &kept]);
    drop(Viewer::join(&replay.address));
    let mut browser = Browser::start();
    let page = browser.open(&replay.url(), (1366, 768));
    browser.wait(&page, "window.wad && wad.frames > 1 && wad.hello.mode === 'replay'");
    assert!(browser.ask(&page, "wad.hello.ticks").as_u64().unwrap() > 5);
    assert_eq!(browser.ask(&page, "document.querySelectorAll('#episodes li').length"), 2);

    // It plays to its end, which says how it ended.
    browser.ask(&page, "wad.send({ do: 'speed', factor: 10 })");
    browser.wait(&page, "wad.state.over");
    let counts = "document.getElementById('counts').textContent";
    let told = browser.ask(&page, counts);
    let last = browser.ask(&page, "wad.hello.ticks - 1");
    assert_eq!(browser.ask(&page, "wad.state.tick"), last);
    assert!(browser.ask(&page, "document.querySelectorAll('#events li.bad, #events li.warn').length") != 0);

    // The timeline goes where it is dragged, and the same state comes back.
    let scrub = |tick: u64| {
        format!(
            "(() => {{ const s = document.getElementById('scrub'); s.value = {tick}; s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); }})()"
        )
    };
    assert_eq!(browser.ask(&page, "wad.state.paused"), true);
    let mut seen = Vec::new();
    for tick in [4, 1, 4] {
        browser.ask(&page, &scrub(tick));
        browser.wait(&page, &format!("wad.state.tick === {tick}"));
        seen.push(browser.ask(&page, "[wad.state.ego.x, wad.state.ego.y, wad.state.time].join()"));
    }
    assert!(seen[0] == seen[2] && seen[0] != seen[1], "{seen:?}");

    // One that cannot be shown is told, and hides no event of the one that plays.
    browser.ask(&page, "wad.send({ do: 'open', episode: 'nowhere' })");
    browser.wait(&page, "document.getElementById('events').textContent.includes('nowhere cannot be shown')");
    browser.ask(&page, &scrub(last.as_u64().unwrap()));
    browser.wait(&page, &format!("wad.state.tick === {last} && {counts} === {told}"));

    // Another one from the list.
    let first = browser.ask(&page, "wad.hello.episode");
    browser.ask(&page, "[...document.querySelectorAll('#episodes button')].find((b) => !b.hasAttribute('aria-current')).click()");
    browser.wait(&page, &format!("wad.hello.episode !== {first}"));
    browser.wait(&page, "wad.state.tick > 1 && document.querySelector('#episodes [aria-current]')");
    assert_eq!(browser.complaints, Vec::<String>::new());
    assert_eq!(replay.stop(), Some(0));
}
