//! A drive as one MCAP file in Foxglove's schemas, which Foxglove and Rerun show: picture, boxes, map, traffic, the ego's
//! pose, the reward.
//!
//! | topic | schema | content |
//! |---|---|---|
//! | `/camera` | `foxglove.CompressedImage` | the front camera's picture, JPEG |
//! | `/camera/calibration` | `foxglove.CameraCalibration` | its lens |
//! | `/camera/boxes` | `foxglove.ImageAnnotations` | what the detector found |
//! | `/map` | `foxglove.SceneUpdate` | the lanes' centre lines and crossings, once |
//! | `/traffic` | `foxglove.SceneUpdate` | ego, vehicles and pedestrians in sight as boxes |
//! | `/ego` | `foxglove.PoseInFrame` | the centre of the ego's footprint |
//! | `/tf` | `foxglove.FrameTransform` | `map` to `ego`, `ego` to `camera` |
//! | `/reward` | `wad_cosim.Reward` | the reward's terms of the tick and their total |
//!
//! Messages are JSON, their schemas JSON Schema. Frames: `map` is the world frame; `ego` is x ahead, y left, z up; `camera`
//! is x right, y down, z ahead. Times are SUMO's clock; where that begins again, the file's goes on.

use crate::perception::Detection;
use crate::record::RecordError;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use sumo_network::geometry::Pose;
use sumo_network::network::{EdgeKind, Network};
use sumo_network::world::{Actor, ActorKind, WorldState};
use wad_camera::{CameraConfig, Frame, Picture};

/// What a tick adds to the file.
pub struct Moment<'a> {
    /// SUMO's clock (s).
    pub time: f64,
    /// The ego as others see it.
    pub ego: &'a Actor,
    /// The road users in its sight.
    pub world: &'a WorldState,
    /// The front camera's picture.
    pub frame: Option<&'a Frame>,
    /// What a detector found in it.
    pub detections: &'a [Detection],
    /// The reward's terms by name.
    pub reward: &'a [(&'static str, f64)],
}

/// A file under way.
pub struct DriveLog {
    writer: Writer<BufWriter<File>>,
    path: PathBuf,
    channels: BTreeMap<&'static str, u16>,
    camera: CameraConfig,
    sequence: u32,
    /// The last moment's time in the file (s), and what is added to SUMO's clock.
    last: f64,
    offset: f64,
}

/// Between the last moment of an episode and the first of the next one whose clock began again (s).
const PAUSE: f64 = 1.0;

impl DriveLog {
    /// A file for drives in `network` with pictures of `camera`.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn create(path: &Path, network: &Network, camera: CameraConfig) -> Result<Self, RecordError> {
        let write = |source| RecordError::Write { path: path.to_path_buf(), source };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(write)?;
        }
        let file = BufWriter::new(File::create(path).map_err(write)?);
        let library = format!("wad-cosim {}", env!("CARGO_PKG_VERSION"));
        let options = WriteOptions::new().compression(None).profile("").library(library);
        let failed = |e: mcap::McapError| encode(path, &e);
        let mut writer = options.create(file).map_err(failed)?;
        let mut channels = BTreeMap::new();
        for (topic, name, schema) in topics() {
            let schema = serde_json::to_vec(&schema).map_err(|e| encode(path, &e))?;
            let id = writer.add_schema(name, "jsonschema", &schema).map_err(failed)?;
            channels.insert(topic, writer.add_channel(id, topic, "json", &BTreeMap::new()).map_err(failed)?);
        }
        let path = path.to_path_buf();
        let mut log = Self { writer, path, channels, camera, sequence: 0, last: -1.0, offset: 0.0 };
        log.write("/map", 0.0, &scene(vec![map(network)]))?;
        Ok(log)
    }

    /// Adds a tick.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, moment: &Moment<'_>) -> Result<(), RecordError> {
        let mut time = moment.time + self.offset;
        if time <= self.last {
            self.offset += self.last + PAUSE - time;
            time = self.last + PAUSE;
        }
        self.last = time;
        self.sequence += 1;
        let pose = &moment.ego.pose;
        if let Some(frame) = moment.frame.filter(|frame| !frame.rgb.is_empty()) {
            let jpeg = Picture::rgb(frame).jpeg().map_err(|e| encode(&self.path, &e))?;
            let image = json!({
                "timestamp": stamp(time), "frame_id": "camera", "format": "jpeg", "data": base64(&jpeg),
            });
            self.write("/camera", time, &image)?;
            let calibration = calibration(&self.camera, time);
            self.write("/camera/calibration", time, &calibration)?;
            self.write("/camera/boxes", time, &boxes(moment.detections, time))?;
        }
        self.write("/traffic", time, &scene(traffic(moment, time)))?;
        let here = json!({ "timestamp": stamp(time), "frame_id": "map", "pose": pose_of(pose) });
        self.write("/ego", time, &here)?;
        self.write("/tf", time, &transform(time, "map", "ego", &pose_of(pose)))?;
        let mount = mounted(&self.camera);
        self.write("/tf", time, &transform(time, "ego", "camera", &mount))?;
        let mut terms: serde_json::Map<String, Value> =
            moment.reward.iter().map(|(name, value)| ((*name).to_string(), json!(value))).collect();
        terms.insert("total".to_string(), json!(moment.reward.iter().map(|(_, value)| value).sum::<f64>()));
        self.write("/reward", time, &Value::Object(terms))
    }

    /// Completes the file. One that is dropped is completed too, but errors are lost.
    ///
    /// # Errors
    /// It cannot be completed.
    pub fn finish(mut self) -> Result<(), RecordError> {
        self.writer.finish().map(drop).map_err(|e| encode(&self.path, &e))
    }

    fn write(&mut self, topic: &'static str, time: f64, message: &Value) -> Result<(), RecordError> {
        let Some(&channel_id) = self.channels.get(topic) else { return Ok(()) };
        let log_time = nanoseconds(time);
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time, publish_time: log_time };
        let data = serde_json::to_vec(message).map_err(|e| encode(&self.path, &e))?;
        self.writer.write_to_known_channel(&header, &data).map_err(|e| encode(&self.path, &e))
    }
}

fn encode(path: &Path, error: &dyn std::fmt::Display) -> RecordError {
    RecordError::Encode { path: path.to_path_buf(), why: error.to_string() }
}

fn nanoseconds(time: f64) -> u64 {
    (time.max(0.0) * 1e9).round() as u64
}

fn stamp(time: f64) -> Value {
    let nanoseconds = nanoseconds(time);
    json!({ "sec": nanoseconds / 1_000_000_000, "nsec": nanoseconds % 1_000_000_000 })
}

fn point(x: f64, y: f64, z: f64) -> Value {
    json!({ "x": x, "y": y, "z": z })
}

fn color([r, g, b]: [f64; 3], a: f64) -> Value {
    json!({ "r": r, "g": g, "b": b, "a": a })
}

/// A pose turned about the vertical.
fn pose_of(pose: &Pose) -> Value {
    let (sin, cos) = (0.5 * pose.heading).sin_cos();
    json!({
        "position": point(pose.position.x, pose.position.y, pose.position.z),
        "orientation": { "x": 0.0, "y": 0.0, "z": sin, "w": cos },
    })
}

/// The camera in the ego's frame, its axes turned to right, down, ahead.
fn mounted(camera: &CameraConfig) -> Value {
    use nalgebra::{Quaternion, UnitQuaternion, Vector3};
    let mount = &camera.mount;
    let optical = UnitQuaternion::from_quaternion(Quaternion::new(0.5, -0.5, 0.5, -0.5));
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), mount.yaw)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -mount.pitch)
        * optical;
    json!({
        "position": point(mount.forward, mount.left, mount.up),
        "orientation": { "x": turned.i, "y": turned.j, "z": turned.k, "w": turned.w },
    })
}

fn transform(time: f64, parent: &str, child: &str, pose: &Value) -> Value {
    json!({
        "timestamp": stamp(time),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": pose["position"],
        "rotation": pose["orientation"],
    })
}

fn calibration(camera: &CameraConfig, time: f64) -> Value {
    let (focal, x, y) = (camera.focal(), 0.5 * camera.width as f64, 0.5 * camera.height as f64);
    json!({
        "timestamp": stamp(time),
        "frame_id": "camera",
        "width": camera.width,
        "height": camera.height,
        "distortion_model": "plumb_bob",
        "D": [0.0, 0.0, 0.0, 0.0, 0.0],
        "K": [focal, 0.0, x, 0.0, focal, y, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [focal, 0.0, x, 0.0, 0.0, focal, y, 0.0, 0.0, 0.0, 1.0, 0.0],
    })
}

/// Foxglove's numbers of lines, in pictures and in scenes.
const LINE_LOOP_2D: u32 = 2;
const LINE_STRIP: u32 = 0;
const LINE_LOOP: u32 = 1;

const BOX: [f64; 3] = [0.1, 0.8, 1.0];

fn boxes(detections: &[Detection], time: f64) -> Value {
    let (mut points, mut texts) = (Vec::new(), Vec::new());
    for detection in detections {
        let [left, top, right, bottom] = detection.bounds;
        let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
        points.push(json!({
            "timestamp": stamp(time),
            "type": LINE_LOOP_2D,
            "points": corners.map(|(x, y)| json!({ "x": x, "y": y })),
            "outline_color": color(BOX, 1.0),
            "outline_colors": [],
            "fill_color": color(BOX, 0.0),
            "thickness": 2.0,
        }));
        texts.push(json!({
            "timestamp": stamp(time),
            "position": { "x": left, "y": top },
            "text": format!("{:?} {:.2}", detection.class, detection.score),
            "font_size": 12.0,
            "text_color": color([1.0; 3], 1.0),
            "background_color": color([0.0; 3], 0.5),
        }));
    }
    json!({ "circles": [], "points": points, "texts": texts })
}

fn scene(entities: Vec<Value>) -> Value {
    json!({ "deletions": [], "entities": entities })
}

/// An entity that stands until one of the same name replaces it.
fn entity(id: &str, time: f64, cubes: Vec<Value>, lines: Vec<Value>) -> Value {
    json!({
        "timestamp": stamp(time),
        "frame_id": "map",
        "id": id,
        "lifetime": { "sec": 0, "nsec": 0 },
        "frame_locked": false,
        "metadata": [],
        "arrows": [], "cubes": cubes, "spheres": [], "cylinders": [], "lines": lines,
        "triangles": [], "texts": [], "models": [],
    })
}

fn map(network: &Network) -> Value {
    let lines = network.lanes.iter().filter_map(|lane| {
        let (tint, kind) = match network.edge(lane.edge).kind {
            EdgeKind::Normal => ([0.75, 0.75, 0.75], LINE_STRIP),
            EdgeKind::Internal => ([0.4, 0.4, 0.4], LINE_STRIP),
            EdgeKind::Crossing => ([1.0, 0.9, 0.3], LINE_STRIP),
            // Its shape is its outline.
            EdgeKind::WalkingArea => ([0.35, 0.45, 0.35], LINE_LOOP),
            EdgeKind::Other => return None,
        };
        let points: Vec<Value> = lane.shape.points().iter().map(|p| point(p.x, p.y, p.z)).collect();
        Some(json!({
            "type": kind,
            "pose": { "position": point(0.0, 0.0, 0.0), "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 } },
            "thickness": 0.15,
            "scale_invariant": false,
            "points": points,
            "color": color(tint, 1.0),
            "colors": [],
            "indices": [],
        }))
    });
    entity("map", 0.0, Vec::new(), lines.collect())
}

fn traffic(moment: &Moment<'_>, time: f64) -> Vec<Value> {
    let cube = |actor: &Actor, tint: [f64; 3]| {
        let kind = &actor.actor_type;
        let mut pose = actor.pose;
        pose.position.z += 0.5 * kind.height;
        json!({
            "pose": pose_of(&pose),
            "size": point(kind.length, kind.width, kind.height),
            "color": color(tint, 0.9),
        })
    };
    let vehicles = moment.world.vehicles.iter().map(|actor| {
        let still = actor.actor_type.kind == ActorKind::Object;
        cube(actor, if still { [1.0, 0.5, 0.0] } else { [0.2, 0.4, 0.9] })
    });
    let pedestrians = moment.world.pedestrians.iter().map(|actor| cube(actor, [0.9, 0.8, 0.2]));
    vec![
        entity("ego", time, vec![cube(moment.ego, [0.86, 0.12, 0.12])], Vec::new()),
        entity("vehicles", time, vehicles.collect(), Vec::new()),
        entity("pedestrians", time, pedestrians.collect(), Vec::new()),
    ]
}

/// Standard base64, padded.
fn base64(bytes: &[u8]) -> String {
    base64::Engine::encode(&base64::engine::general_purpose::STANDARD, bytes)
}

/// Topics with the names of their schemas and the schemas.
fn topics() -> Vec<(&'static str, &'static str, Value)> {
    let number = || json!({ "type": "number" });
    let text = || json!({ "type": "string" });
    let whole = || json!({ "type": "integer", "minimum": 0 });
    let object = |fields: &[(&str, Value)]| {
        let fields: serde_json::Map<String, Value> =
            fields.iter().map(|(name, schema)| ((*name).to_string(), schema.clone())).collect();
        json!({ "type": "object", "properties": fields })
    };
    let list = |item: &Value| json!({ "type": "array", "items": item });
    let time = object(&[("sec", whole()), ("nsec", whole())]);
    let flat = object(&[("x", number()), ("y", number())]);
    let vector = object(&[("x", number()), ("y", number()), ("z", number())]);
    let turn = object(&[("x", number()), ("y", number()), ("z", number()), ("w", number())]);
    let tint = object(&[("r", number()), ("g", number()), ("b", number()), ("a", number())]);
    let pose = object(&[("position", vector.clone()), ("orientation", turn.clone())]);
    let titled = |name: &str, mut schema: Value| {
        schema["title"] = json!(name);
        schema
    };
    let image = object(&[
        ("timestamp", time.clone()),
        ("frame_id", text()),
        ("data", json!({ "type": "string", "contentEncoding": "base64" })),
        ("format", text()),
    ]);
    let numbers = list(&number());
    let lens = object(&[
        ("timestamp", time.clone()),
        ("frame_id", text()),
        ("width", whole()),
        ("height", whole()),
        ("distortion_model", text()),
        ("D", numbers.clone()),
        ("K", numbers.clone()),
        ("R", numbers.clone()),
        ("P", numbers),
    ]);
    let outline = object(&[
        ("timestamp", time.clone()),
        ("type", whole()),
        ("points", list(&flat)),
        ("outline_color", tint.clone()),
        ("outline_colors", list(&tint)),
        ("fill_color", tint.clone()),
        ("thickness", number()),
    ]);
    let label = object(&[
        ("timestamp", time.clone()),
        ("position", flat),
        ("text", text()),
        ("font_size", number()),
        ("text_color", tint.clone()),
        ("background_color", tint.clone()),
    ]);
    let any = list(&json!({ "type": "object" }));
    let annotations =
        object(&[("circles", any.clone()), ("points", list(&outline)), ("texts", list(&label))]);
    let cube = object(&[("pose", pose.clone()), ("size", vector.clone()), ("color", tint.clone())]);
    let line = object(&[
        ("type", whole()),
        ("pose", pose.clone()),
        ("thickness", number()),
        ("scale_invariant", json!({ "type": "boolean" })),
        ("points", list(&vector)),
        ("color", tint.clone()),
        ("colors", list(&tint)),
        ("indices", list(&whole())),
    ]);
    let drawn = object(&[
        ("timestamp", time.clone()),
        ("frame_id", text()),
        ("id", text()),
        ("lifetime", time.clone()),
        ("frame_locked", json!({ "type": "boolean" })),
        ("metadata", list(&object(&[("key", text()), ("value", text())]))),
        ("arrows", any.clone()),
        ("cubes", list(&cube)),
        ("spheres", any.clone()),
        ("cylinders", any.clone()),
        ("lines", list(&line)),
        ("triangles", any.clone()),
        ("texts", any.clone()),
        ("models", any),
    ]);
    let deleted = object(&[("timestamp", time.clone()), ("type", whole()), ("id", text())]);
    let update = object(&[("deletions", list(&deleted)), ("entities", list(&drawn))]);
    let located = object(&[("timestamp", time.clone()), ("frame_id", text()), ("pose", pose)]);
    let moved = object(&[
        ("timestamp", time),
        ("parent_frame_id", text()),
        ("child_frame_id", text()),
        ("translation", vector),
        ("rotation", turn),
    ]);
    let terms = json!({ "type": "object", "additionalProperties": { "type": "number" }, "properties": { "total": { "type": "number" } } });
    [
        ("/camera", "foxglove.CompressedImage", image),
        ("/camera/calibration", "foxglove.CameraCalibration", lens),
        ("/camera/boxes", "foxglove.ImageAnnotations", annotations),
        ("/map", "foxglove.SceneUpdate", update.clone()),
        ("/traffic", "foxglove.SceneUpdate", update),
        ("/ego", "foxglove.PoseInFrame", located),
        ("/tf", "foxglove.FrameTransform", moved),
        ("/reward", "wad_cosim.Reward", terms),
    ]
    .map(|(topic, name, schema)| (topic, name, titled(name, schema)))
    .into()
}
