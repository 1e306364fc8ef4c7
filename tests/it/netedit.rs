//! Every shipped scenario in the real netedit: opened, edited, saved, and still the same.

use crate::scenario::Copy;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use wad_cosim::bundled;
use wad_cosim::network::{Network, Shapes};
use wad_cosim::scenario::{self, Scenario};
use wad_cosim::sumo_config::{OptionSchema, SumoConfig};
use wad_cosim::traci::process::SumoInstall;

/// An X server without a screen, on a display of its own.
struct Display {
    server: Child,
    name: String,
}

impl Display {
    fn open() -> Self {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1280x1024x24", "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("netedit needs a display, and Xvfb does not start: run scripts/setup, which installs it");
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        assert!(!number.trim().is_empty(), "Xvfb found no free display");
        Self { server, name: format!(":{}", number.trim()) }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// netedit's own test language: a vehicle type and a point are made, so that it has something to save, and
/// everything is saved.
const STEPS: &str = r#"netedit.setupAndStart(neteditTestRoot)
netedit.changeSupermode("demand")
netedit.changeMode("type")
netedit.focusOnFrame()
netedit.typeKey("tab")
netedit.typeKey("tab")
netedit.typeKey("space")
netedit.saveExistentFile("demands")
netedit.changeSupermode("network")
netedit.changeMode("shape")
netedit.changeElement("shapeFrame", "poi")
netedit.leftClick(referencePosition, netedit.positions.elements.additionals.shapeB)
netedit.saveExistentFile("additionals")
netedit.saveExistentFile("sumoConfig")
netedit.quit(neteditProcess)
"#;

fn edit(display: &Display, config: &Path, steps: &Path) {
    let install = SumoInstall::find().unwrap();
    let mut netedit = install
        .command("netedit")
        .env("DISPLAY", &display.name)
        .args(["--gui-testing", "--window-size", "1000,800", "--sumocfg-file"])
        .arg(config)
        .arg("--test-file")
        .arg(steps)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    loop {
        if let Some(status) = netedit.try_wait().unwrap() {
            assert!(status.success(), "netedit ended with {status}");
            return;
        }
        if began.elapsed() > Duration::from_secs(120) {
            let _ = netedit.kill();
            let _ = netedit.wait();
            panic!("netedit did not end by itself");
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// What a scenario means, in words; what netedit rounds in the last digit is rounded here.
fn meaning(scenario: &Scenario) -> String {
    let mut things: Vec<String> = scenario
        .things
        .iter()
        .map(|t| {
            format!("{} {:?} at {:.1} {:.1} on {:?} {:.1}", t.id, t.kind, t.point.x, t.point.y, t.lane, t.s)
        })
        .collect();
    things.sort();
    let schema = OptionSchema::cached(&SumoInstall::find().unwrap(), false).unwrap();
    let about = scenario::description(&SumoConfig::load(&scenario.config, &schema).unwrap());
    assert!(!about.is_empty(), "{}: no wad.description", scenario.name);
    format!(
        "{about} {} {:?} {:?} {} {:?} {:.1} {things:#?}",
        scenario.task,
        scenario.placement,
        scenario.weather,
        scenario.traffic,
        scenario.time_limit,
        scenario.route.length(),
    )
}

fn shapes(config: &Path, town: &str) -> Vec<String> {
    let nets = config.parent().unwrap().join("../../sumo_nets").join(town);
    let network = Network::load(&nets.join(format!("{town}.net.xml"))).unwrap();
    let found = Shapes::load(&nets.join(format!("{town}.poly.xml")), &network).unwrap();
    let mut shapes: Vec<String> = found.polygons.iter().map(|p| format!("{p:?}")).collect();
    shapes.sort();
    shapes
}

#[test]
fn every_shipped_scenario_survives_netedit() {
    let display = Display::open();
    let mut town_checked = false;
    for name in bundled::scenarios() {
        let copy = Copy::of(&name);
        let config = copy.config();
        let before = meaning(&Scenario::load(&config).unwrap());
        let town =
            if std::fs::read_to_string(&config).unwrap().contains("town3") { "town3" } else { "town5" };
        let town_before = (!town_checked).then(|| shapes(&config, town));
        let steps = copy.folder.join("steps.py");
        std::fs::write(&steps, STEPS).unwrap();
        edit(&display, &config, &steps);
        for (ending, made) in
            [("rou.xml", "<vType id=\"t_0\""), ("add.xml", "<additional"), ("sumocfg", "netedit")]
        {
            let text = std::fs::read_to_string(copy.folder.join(format!("{name}.{ending}"))).unwrap();
            let empty = ending == "add.xml" && !text.contains("<poi") && !text.contains("<poly");
            let saved = ending == "sumocfg" || text.contains(made);
            // A file without a single shape is nobody's: netedit leaves it alone.
            assert!(
                empty || saved && text.contains("generated on"),
                "{name}: netedit did not save {ending}: {text}"
            );
        }
        let after = Scenario::load(&config).unwrap_or_else(|error| panic!("{name} after netedit: {error}"));
        assert_eq!(before, meaning(&after), "{name}");
        if let Some(town_before) = town_before {
            assert_eq!(town_before, shapes(&config, town), "{name}: the town's own polygons");
            town_checked = true;
        }
    }
}

#[test]
fn scenario_edit_opens_netedit_with_its_window_and_view() {
    let display = Display::open();
    let copy = Copy::of("cross");
    let steps = copy.folder.join("steps.py");
    std::fs::write(&steps, "netedit.setupAndStart(neteditTestRoot)\nnetedit.quit(neteditProcess)\n").unwrap();
    let mut command = super::program::wad(&["scenario", "edit"]);
    command.arg(copy.config()).args(["--", "--gui-testing", "--test-file"]).arg(&steps);
    let output = command.env("DISPLAY", &display.name).output().unwrap();
    let said = super::program::stderr(&output);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("F3"), "{said}");
}
