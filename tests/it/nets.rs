//! Nets built, imported and enriched by the real netconvert, then driven on.

use std::path::{Path, PathBuf};
use wad_cosim::bridge::BridgeOptions;
use wad_cosim::bundled;
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::nets::{self, NetError, Wanted};
use wad_cosim::network::{Network, Shapes};
use wad_cosim::traci::process::SumoInstall;
use wad_cosim::traffic::{Counts, TrafficSpec};

/// A crossroads with a signal, a side street and two houses, in OpenStreetMap's own words.
const TOWN: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<osm version="0.6" generator="wad-cosim">
  <bounds minlat="50.0000" minlon="8.0000" maxlat="50.0060" maxlon="8.0090"/>
  <node id="1" lat="50.0030" lon="8.0000"/>
  <node id="2" lat="50.0030" lon="8.0045"><tag k="highway" v="traffic_signals"/></node>
  <node id="3" lat="50.0030" lon="8.0090"/>
  <node id="4" lat="50.0000" lon="8.0045"/>
  <node id="5" lat="50.0060" lon="8.0045"/>
  <node id="11" lat="50.0034" lon="8.0050"/><node id="12" lat="50.0034" lon="8.0053"/>
  <node id="13" lat="50.0036" lon="8.0053"/><node id="14" lat="50.0036" lon="8.0050"/>
  <way id="100"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="secondary"/><tag k="lanes" v="4"/><tag k="maxspeed" v="50"/></way>
  <way id="101"><nd ref="4"/><nd ref="2"/><nd ref="5"/><tag k="highway" v="residential"/><tag k="maxspeed" v="30"/></way>
  <way id="200"><nd ref="11"/><nd ref="12"/><nd ref="13"/><nd ref="14"/><nd ref="11"/><tag k="building" v="yes"/></way>
</osm>
"#;

fn game(name: &str) -> PathBuf {
    SumoInstall::find().unwrap().home().join("tools/game").join(name)
}

/// Drives some ticks among others; returns the most pedestrians that were there.
fn drive(config: &Path, traffic: Counts, ticks: usize) -> usize {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let dir = tempfile::tempdir().unwrap();
    runtime.block_on(async {
        let traffic = TrafficSpec::Counts(traffic);
        let bridge = BridgeOptions { traffic, ..BridgeOptions::new(config, dir.path().join("sumo")) };
        let mut drive = Drive::start(DriveOptions::new(bridge, dir.path().join("run"))).await.unwrap();
        let mut most = 0;
        for _ in 0..ticks {
            drive.tick().await.unwrap();
            most = most.max(drive.bridge().counts().1);
        }
        let summary = drive.finish(false).await.unwrap();
        assert!(summary.distance_m > 5.0, "{summary:?}");
        most
    })
}

#[test]
fn openstreetmap_comes_with_signals_and_buildings_and_is_driven_on() {
    let dir = tempfile::tempdir().unwrap();
    let osm = dir.path().join("town.osm");
    std::fs::write(&osm, TOWN).unwrap();
    // The folder's name becomes the files', also in XML.
    let out = dir.path().join("R&D");
    let made = nets::import(&osm, &out).unwrap();
    let network = Network::load(&made.net).unwrap();
    let shapes = Shapes::load(&made.polygons.unwrap(), &network).unwrap();
    let facts = nets::facts(&network, &shapes, "town");
    assert_eq!((facts.signals, facts.buildings), (1, 1), "{facts:?}");
    assert!(facts.sidewalks > 0 && facts.crossings > 0, "{facts:?}");
    assert_eq!(facts.speed_limits_kmh, [30, 50]);
    assert!(drive(&made.config, Counts::new(3, 5), 60) > 0);
    assert!(matches!(nets::import(&osm, &out), Err(NetError::Taken { .. })));
}

#[test]
fn opendrive_and_plain_sources_become_nets() {
    let dir = tempfile::tempdir().unwrap();
    let town = Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/town5");
    let install = SumoInstall::find().unwrap();
    let xodr = dir.path().join("town5.xodr");
    let converted = install
        .command("netconvert")
        .arg("-s")
        .arg(town.join("town5.net.xml"))
        .arg("--opendrive-output")
        .arg(&xodr)
        .output()
        .unwrap();
    assert!(converted.status.success());
    let made = nets::import(&xodr, &dir.path().join("drive")).unwrap();
    let network = Network::load(&made.net).unwrap();
    let shipped = Network::load(&town.join("town5.net.xml")).unwrap();
    let lanes = |n: &Network| n.drivable_lanes(wad_cosim::network::VehicleClass::Passenger).len();
    assert!(lanes(&network) * 10 > lanes(&shipped) * 9, "{} of {}", lanes(&network), lanes(&shipped));
    drive(&made.config, Counts::new(5, 0), 60);

    let made = nets::build(&town.join("town5.edg.xml"), &dir.path().join("plain")).unwrap();
    assert_eq!(lanes(&Network::load(&made.net).unwrap()), lanes(&shipped));
}

#[test]
fn every_bundled_town_is_what_its_sources_give() {
    let dir = tempfile::tempdir().unwrap();
    for town in bundled::towns() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets").join(&town);
        let shipped = Network::load(&folder.join(format!("{town}.net.xml"))).unwrap();
        let made = nets::build(&folder.join(format!("{town}.netccfg")), &dir.path().join(&town)).unwrap();
        let moved = nets::compare(&shipped, &Network::load(&made.net).unwrap());
        let lanes = shipped.drivable_lanes(wad_cosim::network::VehicleClass::Passenger).len();
        assert_eq!((moved.compared, moved.missing, moved.lanes), (lanes, 0, 0), "{town}: {moved:?}");
    }
}

#[test]
fn enriched_nets_keep_their_lanes_on_their_lines() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["grid6/grid6.net.xml", "corridor/corridor.net.xml", "bs3d/bs.net.xml"] {
        let from = game(name);
        let to = dir.path().join(name.replace('/', "-"));
        let old = Network::load(&from).unwrap();
        let wanted = Wanted { sidewalks: true, crossings: true, ..Wanted::missing(&old) };
        let done = nets::enrich(&from, &to, wanted).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!((done.moved.lanes, done.moved.missing), (0, 0), "{name}: {done:?}");
        // Measured again, from the files.
        let new = Network::load(&to).unwrap();
        let again = nets::compare(&old, &new);
        let kept = |id: &str| new.traffic_lights.iter().any(|light| light.id == id);
        let dropped: Vec<_> =
            old.traffic_lights.iter().map(|light| light.id.clone()).filter(|id| !kept(id)).collect();
        assert_eq!(done.dropped_signals, dropped, "{name}");
        assert!(again.worst <= 0.02 && again.compared > 10, "{name}: {again:?}");
        let pedestrians = drive(&to, Counts::new(5, 8), 60);
        if name.starts_with("grid6") {
            assert!(done.sidewalks.1 > 0 && done.crossings.1 > 0, "{done:?}");
            assert!(pedestrians > 0, "pedestrians walk on it");
        }
    }
}

#[test]
fn facts_name_what_is_missing_and_which_command_adds_it() {
    // Signals, roundabouts, crossings.
    for (town, counts) in [("town3", (14, 1, 66)), ("town5", (17, 1, 63)), ("town7", (8, 2, 90))] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets").join(town);
        let network = Network::load(&folder.join(format!("{town}.net.xml"))).unwrap();
        let shapes = Shapes::load(&folder.join(format!("{town}.poly.xml")), &network).unwrap();
        let facts = nets::facts(&network, &shapes, town);
        assert!(facts.problems.is_empty(), "{town}: {:?}", facts.problems);
        assert_eq!((facts.signals, facts.roundabouts, facts.crossings), counts, "{facts:?}");
        assert!(facts.tasks.iter().all(|task| task.placed) && facts.connected > 0.99, "{facts:?}");
        assert_eq!(facts.climb_m > 5.0, town == "town7", "{facts:?}");
    }

    let bare = Network::load(&game("grid6/grid6.net.xml")).unwrap();
    let facts = nets::facts(&bare, &Shapes::default(), "grid6");
    let said = format!("{:?}", facts.problems);
    assert!(said.contains("no sidewalks") && said.contains("net enrich grid6 --sidewalks"), "{said}");
}

#[test]
fn lanes_that_would_be_missing_are_counted() {
    let moved = nets::Moved { missing: 3, ..nets::Moved::default() };
    let error = NetError::Moved(moved).to_string();
    assert_eq!(error, "3 lanes for cars would be missing: nothing is written");
}

#[test]
fn what_is_no_source_of_a_net_is_said_so() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let text = dir.path().join("notes.txt");
    std::fs::write(&text, "hello").unwrap();
    for (path, expected) in [(text.clone(), "OpenDRIVE"), (dir.path().join("gone.osm"), "OpenStreetMap")] {
        let error = nets::import(&path, &out).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains(&path.display().to_string()), "{error}");
    }
    let broken = dir.path().join("broken.osm");
    std::fs::write(&broken, "<osm><node id=").unwrap();
    let error = nets::import(&broken, &out).unwrap_err().to_string();
    assert!(error.contains("netconvert failed") && error.contains("broken.osm"), "{error}");
    assert!(!out.exists(), "nothing is left");
    assert!(nets::build(&text, &out).unwrap_err().to_string().contains(".netccfg"));
    let error =
        nets::enrich(&text, &out, Wanted { signals: true, ..Wanted::default() }).unwrap_err().to_string();
    assert!(error.contains("notes.txt"), "{error}");
}
