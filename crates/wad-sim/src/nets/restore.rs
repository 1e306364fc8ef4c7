//! Keeps lanes on their lines. netconvert computes all geometry again when it reads a net. Lanes end earlier
//! where a junction grows for a crossing, which is wanted. They also shift sideways if the net was built with
//! other options, which is not wanted. So each lane is put back onto its old line, between the new ends.

use super::NetError;
use nalgebra::Point3;
use quick_xml::events::{BytesStart, Event};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::{self, Write as _};
use std::path::Path;
use sumo_network::geometry::{Point, Polyline};
use sumo_network::network::{EdgeKind, LaneId, Network, VehicleClass};

/// How far the lanes of two nets lie apart.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Moved {
    /// Lanes for cars that both nets have.
    pub compared: usize,
    /// Lanes for cars of the first net that the second lacks.
    pub missing: usize,
    /// Lanes that leave their line by more than 2 cm.
    pub lanes: usize,
    /// How far the worst of these leaves its line (m).
    pub worst: f64,
    /// The name of the worst lane.
    pub worst_lane: String,
    /// Lanes that end or begin elsewhere along their line.
    pub cut: usize,
    /// How far the worst of these is cut or grows (m).
    pub most_cut: f64,
}

impl fmt::Display for Moved {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { missing, lanes, worst, worst_lane, .. } = self;
        let off = format!("{lanes} lanes would leave their line, `{worst_lane}` by {worst:.2} m");
        match (lanes, missing) {
            (_, 0) => write!(f, "{off}"),
            (0, _) => write!(f, "{missing} lanes for cars would be missing"),
            _ => write!(f, "{missing} lanes for cars would be missing, and {off}"),
        }
    }
}

/// Beyond this a lane has left its line (m): twice what two decimals round.
const OFF: f64 = 0.02;

/// By edge id: lanes for cars, outermost first.
fn car_lanes(network: &Network) -> BTreeMap<&str, Vec<LaneId>> {
    let roads = network.edges.iter().filter(|edge| edge.kind == EdgeKind::Normal);
    roads
        .map(|edge| {
            let open = |lane: &&LaneId| network.lane(**lane).permissions.allows(VehicleClass::Passenger);
            (edge.id.as_str(), edge.lanes.iter().filter(open).copied().collect())
        })
        .collect()
}

/// Compares the lanes for cars of two nets, by edge and order: how far `new` leaves the lines of `old`.
pub fn compare(old: &Network, new: &Network) -> Moved {
    let (before, after) = (car_lanes(old), car_lanes(new));
    let mut moved = Moved::default();
    for (edge, lanes) in &before {
        let others = after.get(edge).filter(|others| others.len() == lanes.len());
        let Some(others) = others else {
            moved.missing += lanes.len();
            continue;
        };
        for (&lane, &other) in lanes.iter().zip(others) {
            let (line, shape) = (&old.lane(lane).shape, &new.lane(other).shape);
            moved.compared += 1;
            let off = shape.points().iter().map(|p| line.project(p.xy()).distance).fold(0.0, f64::max);
            if off > OFF {
                moved.lanes += 1;
            }
            if off > moved.worst {
                (moved.worst, moved.worst_lane) = (off, new.lane(other).id.clone());
            }
            let ends = |line: &Polyline| [line.at(0.0).xy(), line.at(line.length()).xy()];
            let cut = ends(line).iter().zip(ends(shape)).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            moved.cut += usize::from(cut > OFF);
            moved.most_cut = moved.most_cut.max(cut);
        }
    }
    moved
}

/// A shorter piece of an old lane is not worth keeping (m): the whole old lane is.
const SHORTEST: f64 = 1.0;

/// The new shape of each lane of `new` that has to change, by id: roads' lanes on the lines of `old`, lanes
/// inside junctions joined to them.
fn shapes(old: &Network, new: &Network) -> HashMap<String, Vec<Point3<f64>>> {
    let (before, after) = (car_lanes(old), car_lanes(new));
    let mut shapes: HashMap<LaneId, Vec<Point3<f64>>> = HashMap::new();
    for (edge, lanes) in &before {
        let Some(others) = after.get(edge).filter(|others| others.len() == lanes.len()) else { continue };
        for (&lane, &other) in lanes.iter().zip(others) {
            let (line, shape) = (&old.lane(lane).shape, &new.lane(other).shape);
            let off = shape.points().iter().map(|p| line.project(p.xy()).distance).fold(0.0, f64::max);
            if off <= 0.5 * OFF {
                continue;
            }
            let (a, b) = (line.project(shape.at(0.0).xy()).s, line.project(shape.at(shape.length()).xy()).s);
            let piece = if b - a > SHORTEST { cut(line, a, b) } else { points(line) };
            shapes.insert(other, piece);
        }
    }
    let end = |lane: LaneId, last: bool, shapes: &HashMap<LaneId, Vec<Point3<f64>>>| {
        let shape = shapes.get(&lane)?;
        if last { shape.last().copied() } else { shape.first().copied() }
    };
    let changed: BTreeSet<LaneId> = shapes.keys().copied().collect();
    for link in &new.links {
        let (Some(&first), Some(&last)) = (link.via.first(), link.via.last()) else { continue };
        if changed.contains(&link.from) {
            let from = end(link.from, true, &shapes);
            join(new, &mut shapes, first, from, true);
        }
        if changed.contains(&link.to) {
            let to = end(link.to, false, &shapes);
            join(new, &mut shapes, last, to, false);
        }
    }
    shapes.into_iter().map(|(lane, shape)| (new.lane(lane).id.clone(), shape)).collect()
}

/// Lets a lane inside a junction begin or end where the road's lane now does.
fn join(
    network: &Network,
    shapes: &mut HashMap<LaneId, Vec<Point3<f64>>>,
    lane: LaneId,
    at: Option<Point3<f64>>,
    first: bool,
) {
    let Some(at) = at else { return };
    let shape = shapes.entry(lane).or_insert_with(|| points(&network.lane(lane).shape));
    let end = if first { shape.first_mut() } else { shape.last_mut() };
    if let Some(end) = end {
        *end = at;
    }
}

/// The points of a line, two or more: one of no length (a turn on the spot) has both its ends in one point, and
/// SUMO reads no lane of one point.
fn points(line: &Polyline) -> Vec<Point3<f64>> {
    let mut points = line.points().to_vec();
    if let [only] = points[..] {
        points.push(only);
    }
    points
}

/// The piece of a line from `a` to `b` (m).
fn cut(line: &Polyline, a: f64, b: f64) -> Vec<Point3<f64>> {
    let between =
        line.points().iter().zip(line.arc_lengths()).filter(|(_, s)| **s > a + 0.01 && **s < b - 0.01);
    let mut piece = vec![line.at(a).position];
    piece.extend(between.map(|(p, _)| *p));
    piece.push(line.at(b).position);
    piece
}

/// Writes the net `text` again with its lanes on the lines of `old`. Returns it with the number of lanes put
/// back.
pub fn restore(path: &Path, text: &str, old: &Network, new: &Network) -> Result<(String, usize), NetError> {
    let shapes = shapes(old, new);
    if shapes.is_empty() {
        return Ok((text.to_string(), 0));
    }
    let malformed = |problem: String| NetError::Malformed { path: path.to_path_buf(), problem };
    let mut reader = quick_xml::Reader::from_str(text);
    let mut writer = quick_xml::Writer::new(Vec::with_capacity(text.len()));
    let flat = new.lanes.iter().flat_map(|l| l.shape.points()).all(|p| p.z == 0.0);
    loop {
        let event = reader.read_event().map_err(|e| malformed(e.to_string()))?;
        let event = match event {
            Event::Eof => break,
            Event::Start(tag) if tag.name().0 == "lane" => Event::Start(lane(&tag, &shapes, flat)),
            Event::Empty(tag) if tag.name().0 == "lane" => Event::Empty(lane(&tag, &shapes, flat)),
            other => other,
        };
        writer.write_event(event).map_err(|e| malformed(e.to_string()))?;
    }
    let text = String::from_utf8(writer.into_inner()).map_err(|e| malformed(e.to_string()))?;
    Ok((text, shapes.len()))
}

fn lane(tag: &BytesStart<'_>, shapes: &HashMap<String, Vec<Point3<f64>>>, flat: bool) -> BytesStart<'static> {
    let mut id = String::new();
    let attributes: Vec<(String, String)> = tag
        .attributes()
        .with_checks(false)
        .flatten()
        .map(|a| (a.key.0.to_string(), a.value.to_string()))
        .inspect(|(key, value)| {
            if key == "id" {
                id.clone_from(value);
            }
        })
        .collect();
    let shape = shapes.get(&id);
    let mut out = BytesStart::new("lane");
    for (key, value) in &attributes {
        let value = match (key.as_str(), shape) {
            ("shape", Some(shape)) => written(shape, flat),
            ("length", Some(shape)) => format!("{:.2}", length(shape).max(0.1)),
            _ => value.clone(),
        };
        // As it stood in the file: escaped already.
        out.push_attribute(quick_xml::events::attributes::Attribute {
            key: quick_xml::name::QName(key),
            value: value.into(),
        });
    }
    out
}

fn written(shape: &[Point3<f64>], flat: bool) -> String {
    let mut text = String::new();
    for p in shape {
        let space = if text.is_empty() { "" } else { " " };
        let _ = if flat {
            write!(text, "{space}{:.2},{:.2}", p.x, p.y)
        } else {
            write!(text, "{space}{:.2},{:.2},{:.2}", p.x, p.y, p.z)
        };
    }
    text
}

fn length(shape: &[Point3<f64>]) -> f64 {
    shape.windows(2).map(|pair| (Point::from(pair[1].xy()) - Point::from(pair[0].xy())).norm()).sum()
}
