//! Launching, and every way in which SUMO goes away.

use super::{Town, steps};
use std::time::{Duration, Instant};
use wad_cosim::traci::*;

#[tokio::test]
async fn a_config_that_does_not_exist_is_named() {
    let error = SumoProcess::launch(&LaunchOptions::config("/nowhere/town.sumocfg")).await.unwrap_err();
    assert!(matches!(error, LaunchError::Input { .. }), "{error:?}");
    assert!(error.to_string().contains("/nowhere/town.sumocfg"), "{error}");
}

#[tokio::test]
async fn what_sumo_says_of_a_bad_config_is_quoted() {
    let town = Town::new();
    std::fs::write(town.path("bad.sumocfg"), "this is not XML").unwrap();
    std::fs::write(
        town.path("lost.sumocfg"),
        r#"<configuration><net-file value="lost.net.xml"/></configuration>"#,
    )
    .unwrap();
    let log = town.path("sumo.log");
    for (config, words) in [("bad.sumocfg", "invalid document structure"), ("lost.sumocfg", "lost.net.xml")] {
        let mut options = LaunchOptions::config(town.path(config));
        options.log_file = Some(log.clone());
        let error = SumoProcess::launch(&options).await.unwrap_err();
        assert!(matches!(error, LaunchError::Exited(_)), "{error:?}");
        let text = error.to_string();
        assert!(
            text.contains(words) && text.contains("sumo.log") && text.contains("exit status: 1"),
            "{text}"
        );
    }
    let error = SumoProcess::launch(&town.options().option("no-such-option", 1)).await.unwrap_err();
    assert!(error.to_string().contains("no-such-option"), "{error}");
}

#[tokio::test]
async fn a_killed_sumo_is_told_with_its_signal_and_its_last_words() {
    let town = Town::new();
    let (mut sumo, mut client) = town.launch().await;
    // SUMO logs what it refuses.
    client.get(vehicle::SPEED, "last words").await.unwrap_err();
    // SAFETY: a plain system call on a child of ours.
    assert_eq!(unsafe { libc::kill(sumo.id() as i32, libc::SIGKILL) }, 0);
    let error = client.step().await.unwrap_err();
    assert!(error.is_closed() && error.is_fatal(), "{error:?}");
    let text = sumo.explain(error).await.to_string();
    for words in ["simulation step", "signal: 9", "last words"] {
        assert!(text.contains(words), "{words} is not in: {text}");
    }
    assert!(matches!(client.step().await, Err(Error::Unusable)));
}

#[tokio::test]
async fn a_sumo_that_hangs_runs_into_the_time_limit() {
    let town = Town::new();
    let (mut sumo, mut client) = town.launch().await;
    // SAFETY: a plain system call on a child of ours.
    assert_eq!(unsafe { libc::kill(sumo.id() as i32, libc::SIGSTOP) }, 0);
    client.set_timeout(Some(Duration::from_millis(200)));
    let begin = Instant::now();
    let error = client.step().await.unwrap_err();
    assert!(begin.elapsed() < Duration::from_secs(5));
    let text = sumo.explain(error).await.to_string();
    assert!(text.contains("0.2 s") && text.contains("simulation step"), "{text}");
}

#[tokio::test]
async fn dropping_the_process_ends_sumo() {
    let town = Town::new();
    let (sumo, _client) = town.launch().await;
    let folder = format!("/proc/{}", sumo.id());
    assert!(std::path::Path::new(&folder).exists());
    drop(sumo);
    assert!(!std::path::Path::new(&folder).exists());
}

#[tokio::test]
async fn several_launch_at_once_and_none_shares_a_sumo() {
    let town = Town::new();
    let options = town.options();
    let launches: Vec<_> = (0..4)
        .map(|_| {
            let options = options.clone();
            tokio::spawn(async move { SumoProcess::launch(&options).await })
        })
        .collect();
    let mut running = Vec::new();
    for launch in launches {
        running.push(launch.await.unwrap().unwrap());
    }
    for (n, (_, client)) in running.iter_mut().enumerate() {
        steps(client, n + 1).await;
        assert_eq!(client.get(simulation::TIME, "").await.unwrap(), 0.5 * (n + 1) as f64);
    }
}

#[tokio::test]
async fn the_listener_is_gone_once_we_are_connected() {
    let town = Town::new();
    let (sumo, mut client) = town.launch().await;
    let second = Client::attach(&format!("127.0.0.1:{}", sumo.port())).await;
    assert!(matches!(second, Err(Error::Connect { .. })), "{second:?}");
    steps(&mut client, 1).await;
}

#[tokio::test]
async fn attaching_where_nobody_listens_says_so() {
    let error = Client::attach("127.0.0.1:1").await.unwrap_err();
    assert!(
        error.to_string().contains("127.0.0.1:1") && error.to_string().contains("--remote-port"),
        "{error}"
    );
}

#[tokio::test]
async fn load_starts_over_and_states_are_restored() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    steps(&mut client, 10).await;
    let state = town.path("state.xml.gz");
    let state = state.to_str().unwrap();
    client.save_state(state).await.unwrap();
    let place = client.get(vehicle::POSITION, "first").await.unwrap();
    steps(&mut client, 10).await;
    assert_ne!(client.get(vehicle::POSITION, "first").await.unwrap(), place);
    client.load_state(state).await.unwrap();
    assert_eq!(client.get(simulation::TIME, "").await.unwrap(), 5.0);
    let restored = client.get(vehicle::POSITION, "first").await.unwrap();
    assert!((restored.x - place.x).abs() < 0.02, "{restored:?} {place:?}");

    let net = town.path("net.net.xml");
    client.load(&["--net-file", net.to_str().unwrap(), "--no-step-log", "true"]).await.unwrap();
    steps(&mut client, 1).await;
    assert_eq!(client.get(vehicle::ID_COUNT, "").await.unwrap(), 0);
    assert_eq!(client.get(simulation::TIME, "").await.unwrap(), 1.0);
}

/// What our own process leaves behind when it is killed: nothing. This test runs itself again as the victim.
#[test]
fn sumo_dies_with_us_even_by_sigkill() {
    const ROLE: &str = "WAD_COSIM_TEST_VICTIM";
    let name = "traci::process::sumo_dies_with_us_even_by_sigkill";
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    if let Ok(folder) = std::env::var(ROLE) {
        let options = LaunchOptions::config(std::path::Path::new(&folder).join("town.sumocfg"));
        // Launched from a thread that ends: SUMO must outlive it, and only it.
        let (sumo, _client) = std::thread::spawn(move || {
            let (sumo, client) = runtime.block_on(SumoProcess::launch(&options)).unwrap();
            (sumo, (client, runtime))
        })
        .join()
        .unwrap();
        std::thread::sleep(Duration::from_millis(300));
        std::fs::write(std::path::Path::new(&folder).join("pid.part"), sumo.id().to_string()).unwrap();
        let done = std::path::Path::new(&folder).join("pid");
        std::fs::rename(std::path::Path::new(&folder).join("pid.part"), done).unwrap();
        std::thread::sleep(Duration::from_secs(60));
        return;
    }
    let town = Town::new();
    let mut victim = std::process::Command::new(std::env::current_exe().unwrap())
        .args([name, "--exact", "--nocapture"])
        .env(ROLE, town.path("pid").parent().unwrap())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    let wait = |what: &dyn Fn() -> bool| {
        while !what() {
            assert!(begin.elapsed() < Duration::from_secs(30), "nothing happened in 30 s");
            std::thread::sleep(Duration::from_millis(10));
        }
    };
    wait(&|| town.path("pid").exists());
    let pid = std::fs::read_to_string(town.path("pid")).unwrap();
    // The state after "(sumo)" in /proc/PID/stat; a zombie awaits its new parent only.
    let alive = || {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        stat.contains("(sumo)") && !stat.contains("(sumo) Z")
    };
    assert!(alive(), "SUMO ended with the thread that launched it");
    victim.kill().unwrap();
    victim.wait().unwrap();
    wait(&|| !alive());
}
