//! `train eyes` and `eval eyes` on a real SUMO: collected, trained, refused, scored.

use serde_json::Value;
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use wad_cosim::bundled;
use wad_cosim::camera::{CameraConfig, Preset};
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::eyes::Eyes;
use wad_cosim::geometry::Vector;
use wad_cosim::latent::PooledEncoder;
use wad_cosim::observation::ObservationMode;
use wad_cosim::perception::{EgoFacts, LightAhead};
use wad_cosim::traffic::{Counts, TrafficSpec};
use wad_cosim::world::WorldState;

fn wad(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(args).stdin(Stdio::null()).output().expect("the binary runs")
}

fn good(args: &[&str]) -> Value {
    let output = wad(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a JSON line")
}

#[test]
fn what_is_collected_is_trained_on_and_scored() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (data, out) = (path("data"), path("out"));
    let frames = ["--frames", "16", "--per-shard", "8", "--every", "1", "--camera", "--json"];
    good(&[&["dataset", "collect", "--out", &data], &frames[..]].concat());
    let short = ["--epochs", "1", "--batch", "2", "--epoch-steps", "1", "--init", "centernet", "--json"];
    let trained = good(&[&["train", "eyes", "--data", &data, "--out", &out], &short[..]].concat());
    let road = &trained["best"]["road"];
    assert!(road["frames"].as_u64() > Some(0), "{trained}");

    // A head that learns alone goes on alone.
    let alone = path("alone");
    let short = ["--epochs", "1", "--batch", "2", "--epoch-steps", "1", "--init", "eyes", "--only", "area"];
    good(&[&["train", "eyes", "--data", &data, "--out", &alone, "--json"], &short[..]].concat());
    let resumed = good(&["train", "eyes", "--out", &alone, "--resume", "--epochs", "2", "--json"]);
    assert_eq!(resumed["steps"].as_u64(), Some(2), "{resumed}");

    // What it sees is scored beside the objects.
    let weights = trained["detector"].as_str().unwrap().to_string();
    let (eyes, as_centernet) = (format!("eyes:{weights}"), format!("centernet:{weights}"));
    let few = ["--town", "town3", "--frames", "6", "--weather", "ClearNoon", "--json"];
    // Beside it, the paper's chain: lanes by Canny and Hough, no light.
    let both = ["eval", "eyes", "--detector", &eyes, "--detector", "centernet"];
    let scored = good(&[&both, &few[..]].concat());
    let road = |one: usize| scored["detectors"][one]["road"][1].clone();
    let (all, hough) = (road(0), road(1));
    assert_eq!((all[0].as_str(), all[1]["frames"].as_u64()), (Some("all"), Some(6)), "{scored}");
    assert!(all[1]["boundaries"].as_u64() > Some(0), "{scored}");
    assert_eq!(hough[1]["boundaries"], all[1]["boundaries"], "other frames");
    assert!(hough[1]["boundaries_found"].as_f64() > Some(0.5), "{hough}");
    let pictures = ["--pictures", &path("pictures")];
    let refused = wad(&[&both, &few[..], &pictures].concat());
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("give one --detector"));

    // Each name wants its own network.
    for (detector, found) in [(as_centernet.as_str(), "network eyes"), ("eyes:missing", "missing")] {
        let output = wad(&["eval", "detector", "--detector", detector, "--frames", "1"]);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains(found), "{error}");
    }
}

/// `eval eyes` of the bundled eyes in `frames` frames of town5 in hard rain, with these variables.
fn bundled_eyes(frames: &str, variables: &[(&str, &str)]) -> (Value, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(["eval", "eyes", "--detector", "eyes", "--town", "town5", "--weather", "HardRainNoon"]);
    command.args(["--frames", frames, "--json"]).envs(variables.iter().copied()).stdin(Stdio::null());
    let output = command.output().expect("the binary runs");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{errors}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let answer: Value = serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a JSON line");
    (answer["detectors"][0].clone(), errors)
}

/// Boundaries found, lights right, and the share of persons found.
fn shares(scored: &Value) -> [f64; 3] {
    let road = &scored["road"][1][1];
    let persons = &scored["realism"]["classes"]["person"];
    let share = persons["hits"].as_f64().unwrap() / persons["truths"].as_f64().unwrap();
    [road["boundaries_found"].as_f64().unwrap(), road["lights_right"].as_f64().unwrap(), share]
}

#[test]
fn the_bundled_eyes_see_the_same_on_other_processors_and_without_openvino() {
    let (here, errors) = bundled_eyes("60", &[]);
    assert!(!errors.contains("libtorch"), "{errors}");
    let best = shares(&here);
    // Canny and Hough find a third here.
    assert!(best[0] > 0.7, "{here}");
    assert!(best[1] > 0.7, "{here}");
    // Without VNNI; without AVX-512; without AVX, in the camera and encoder too; libtorch in single precision, which may
    // find two more or less of the fourteen persons.
    let others = [
        ("ONEDNN_MAX_CPU_ISA", "AVX512_CORE", 0.02),
        ("ONEDNN_MAX_CPU_ISA", "AVX2", 0.02),
        ("ONEDNN_MAX_CPU_ISA", "SSE41", 0.02),
        ("WAD_COSIM_CPU", "plain", 1e-9),
        ("WAD_COSIM_OPENVINO", "off", 0.15),
        ("WAD_COSIM_OPENVINO", "/nowhere", 0.15),
    ];
    for (variable, value, most) in others {
        let (there, errors) = bundled_eyes("60", &[(variable, value)]);
        for (a, b) in best.iter().zip(shares(&there)) {
            assert!((a - b).abs() < most, "{variable}={value}: {best:?}, {:?}", shares(&there));
        }
        assert_eq!(errors.contains("found no OpenVINO in /nowhere"), value == "/nowhere", "{errors}");
    }
}

/// `world` with two more vehicles: one behind the ego, one `place` (m) from it.
fn with_more(world: &WorldState, drive: &Drive, place: Vector) -> WorldState {
    let mut more = world.clone();
    let pose = drive.ego().state().pose;
    let Some(model) = world.vehicles.first() else { return more };
    for (id, place) in [("behind", Vector::new(-12.0, 0.0)), ("aside", place)] {
        let mut one = model.clone();
        let at = pose.to_world(place);
        (one.id, one.key) = (Arc::from(id), u64::MAX - id.len() as u64);
        (one.pose.position.x, one.pose.position.y, one.pose.position.z) = (at.x, at.y, pose.position.z);
        more.vehicles.push(one);
    }
    more.vehicles.sort_by(|a, b| a.id.cmp(&b.id));
    more
}

#[tokio::test]
async fn an_agent_with_the_camera_alone_gets_no_number_from_what_the_camera_does_not_show() {
    let out = tempfile::tempdir().expect("a folder");
    let config = bundled::resolve("town5").expect("a bundled town");
    let traffic = TrafficSpec::Counts(Counts::new(70, 100));
    let mut drive =
        Drive::start(DriveOptions::passing(config, 3, traffic, out.path())).await.expect("a drive");
    let eyes = |mode: ObservationMode, detector: &str| {
        let encoder = Box::new(PooledEncoder);
        let made = Eyes::of_agent(drive.assets(), mode, detector, CameraConfig::default(), encoder);
        made.map(|mut eyes| {
            eyes.reset(Preset::ClearNoon, 3);
            eyes
        })
    };
    let (camera, both) = (ObservationMode::Camera, ObservationMode::LatentAndRaw);
    let error = eyes(camera, "truth").err().expect("it is told of lights").to_string();
    assert!(error.contains("expected a detector that sees lane and light"), "{error}");
    let (mut one, mut two) = (eyes(camera, "eyes").expect("eyes"), eyes(camera, "eyes").expect("eyes"));
    let (mut told, mut misled) = (eyes(both, "truth").expect("truth"), eyes(both, "truth").expect("truth"));
    let mut probe = Eyes::camera(drive.assets().town(), CameraConfig::default()).expect("a camera");
    let (mut hidden, mut differs) = (0, 0);
    for tick in 0..400 {
        drive.tick().await.expect("a tick");
        if tick < 60 || tick % 4 != 0 {
            continue;
        }
        let (world, pose, step) =
            (drive.ego().world(), drive.ego().state().pose, 4.0 * drive.bridge().tick());
        // Where the simulator says red the camera shows green, and the other way round.
        let turned = |state: &Arc<str>| -> Arc<str> {
            state
                .chars()
                .map(|c| if matches!(c, 'r' | 'y' | 'u') { 'G' } else { 'r' })
                .collect::<String>()
                .into()
        };
        let signals: Vec<Option<Arc<str>>> =
            world.traffic_lights.iter().map(|state| state.as_ref().map(turned)).collect();
        let facts = EgoFacts::of(drive.bridge().network(), drive.ego(), step);
        let false_facts = EgoFacts { signals: &signals, ..facts };

        one.follow(world);
        one.look(&facts).expect("a look");
        let frame = &one.frame().expect("a frame").rgb;
        // 20 to 56 m ahead and as far aside that half the picture's breadth lies between: in it, where no house stands before it.
        let ahead = 20.0 + 12.0 * f64::from(tick / 4 % 4);
        let side = if tick / 16 % 2 == 0 { 0.8 } else { -0.8 };
        let more = with_more(world, &drive, Vector::new(ahead, side * ahead));
        probe.follow(&more);
        probe.glance(&pose);
        let unseen = probe.frame().expect("a frame").rgb == *frame;
        hidden += usize::from(unseen && more.vehicles.len() > world.vehicles.len());
        two.follow(if unseen { &more } else { world });
        two.look(&false_facts).expect("a look");
        let bits =
            |eyes: &Eyes| eyes.observation().concat().into_iter().map(f32::to_bits).collect::<Vec<_>>();
        assert!(bits(&one) == bits(&two), "tick {tick}: {:?}, {:?}", one.raw(), two.raw());

        // The same lie reaches an agent that is told.
        if LightAhead::find(&facts).is_some_and(|light| light.distance < 30.0) {
            for (eyes, facts) in [(&mut told, &facts), (&mut misled, &false_facts)] {
                eyes.follow(world);
                eyes.look(facts).expect("a look");
            }
            differs += usize::from(bits(&told) != bits(&misled));
        }
        if hidden >= 12 && differs >= 3 {
            break;
        }
    }
    assert!(
        hidden >= 12 && differs >= 3,
        "{hidden} vehicles behind walls, {differs} lies that reached the told"
    );
    drive.finish(false).await.expect("a summary");
}
