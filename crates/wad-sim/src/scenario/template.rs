//! New scenarios: a task or an event in a town, as SUMO files to edit in netedit.

use super::params::DESCRIPTION;
use crate::destination::EGO_CLASS;
use crate::tasks::{Placement, Places, Spot, TaskError, TaskKind};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use sumo_network::geometry::{Point, Vector};
use sumo_network::network::{EdgeKind, LaneId, LanePosition, Network, Route, VehicleClass};
use wad_vehicle::EgoParams;

/// A template of a scenario.
#[derive(Clone, Copy, Debug)]
pub struct Template {
    /// Its name on the command line.
    pub name: &'static str,
    /// One line about it.
    pub about: &'static str,
    /// The ego's task, and the kind of place for it.
    task: TaskKind,
    place: Place,
    draw: fn(&Stretch<'_>) -> Vec<Drawn>,
}

/// The kind of place that a template needs.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// A place of its task.
    Task,
    /// Along a road without a junction, of this many lanes for cars at the least.
    Road { lanes: usize },
    /// The same with a sidewalk.
    Street,
    /// Over a signalled junction.
    Signal,
}

/// All templates: the tasks, then the rare events.
pub const TEMPLATES: &[Template] = &[
    task("straight", "400 m straight on, lights held at green", TaskKind::Straight),
    task("one_turn", "400 m with one turn, lights held at green", TaskKind::OneTurn),
    task("roundabout", "into a roundabout by the first arm, out by the third", TaskKind::Roundabout),
    Template {
        draw: |stretch| vec![stretch.point("obstacle.car", 80.0, 0.0)],
        place: Place::Road { lanes: 1 },
        ..task("obstacle", "stand 1 to 10 m before a car that stands in the lane", TaskKind::Obstacle)
    },
    task("cross", "500 m over a signalled junction of four arms", TaskKind::Cross),
    task("composite", "a long way among 70 vehicles and 100 pedestrians", TaskKind::Composite),
    Template {
        name: "pedestrian",
        about: "a pedestrian steps out in front of the ego",
        task: TaskKind::Navigation,
        place: Place::Street,
        draw: |stretch| vec![stretch.point("event.pedestrian", 90.0, stretch.kerb())],
    },
    Template {
        name: "child",
        about: "a child runs out from beside a bench",
        task: TaskKind::Navigation,
        place: Place::Street,
        draw: |stretch| {
            let kerb = stretch.kerb();
            let child = [("wad.person", "child"), ("wad.speed", "2.6")];
            vec![
                stretch.point("event.pedestrian", 95.0, kerb).with(&child),
                stretch.point("bench", 85.0, kerb + 2.5),
            ]
        },
    },
    Template {
        name: "brake",
        about: "the vehicle ahead brakes hard",
        task: TaskKind::Navigation,
        place: Place::Road { lanes: 1 },
        draw: |stretch| vec![stretch.point("event.brake", 120.0, 0.0)],
    },
    Template {
        name: "accident",
        about: "two vehicles have run into each other in the ego's lane; the next lane is free",
        task: TaskKind::Navigation,
        place: Place::Road { lanes: 2 },
        draw: |stretch| vec![stretch.point("event.accident", 110.0, 0.0)],
    },
    Template {
        name: "road_works",
        about: "road works take the ego's lane; the next lane is free",
        task: TaskKind::Navigation,
        place: Place::Road { lanes: 2 },
        draw: |stretch| {
            let cone = |way: f64| stretch.point("obstacle.cone", way, 0.0);
            vec![stretch.area("roadworks", 110.0, 24.0), cone(102.0), cone(106.0)]
        },
    },
    Template {
        name: "lane_closed",
        about: "a lane is closed over 40 m; the next lane is free",
        task: TaskKind::Navigation,
        place: Place::Road { lanes: 2 },
        draw: |stretch| vec![stretch.point("event.lane_closed", 110.0, 0.0).with(&[("wad.length", "40")])],
    },
    Template {
        name: "signal_off",
        about: "the signal of a junction is out of order",
        task: TaskKind::Navigation,
        place: Place::Signal,
        draw: |stretch| {
            let way = stretch.signal().map_or(20.0, |stop| (stop - 3.0).max(1.0));
            vec![stretch.point("event.signal_off", way, 0.0)]
        },
    },
    Template {
        name: "broken_down",
        about: "a truck has broken down in the ego's lane, with a person beside it; the next lane is free",
        task: TaskKind::Navigation,
        place: Place::Road { lanes: 2 },
        draw: |stretch| {
            vec![
                stretch.point("obstacle.truck", 110.0, 0.0),
                stretch.point("obstacle.person", 106.0, stretch.kerb()),
            ]
        },
    },
];

const fn task(name: &'static str, about: &'static str, task: TaskKind) -> Template {
    Template { name, about, task, place: Place::Task, draw: |_| Vec::new() }
}

/// Why there is no new scenario.
#[derive(Debug, thiserror::Error)]
pub enum TemplateError {
    /// No such template.
    #[error("no template is called `{found}`: {fix}")]
    Unknown {
        /// The given name.
        found: String,
        /// The names to choose from.
        fix: String,
    },
    /// The scenario's folder exists.
    #[error("{} exists already: give another name, or remove it first", path.display())]
    Taken {
        /// The folder.
        path: PathBuf,
    },
    /// The name is not usable as a file name.
    #[error("`{name}` cannot be the name of a scenario: use letters, digits, `_` and `-`")]
    Name {
        /// The given name.
        name: String,
    },
    /// The net has no place for the template.
    #[error("this net has no place for `{template}`: {why}")]
    NoPlace {
        /// The template's name.
        template: &'static str,
        /// Which condition fails.
        why: String,
    },
    /// The net has no place for the template's task.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// A file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

/// The template of that name.
///
/// # Errors
/// There is none.
pub fn find(name: &str) -> Result<&'static Template, TemplateError> {
    let names: Vec<&str> = TEMPLATES.iter().map(|t| t.name).collect();
    TEMPLATES.iter().find(|t| t.name == name.replace('-', "_")).ok_or_else(|| TemplateError::Unknown {
        found: name.to_string(),
        fix: crate::suggest::meant(name, &names),
    })
}

/// A point or polygon to be drawn.
struct Drawn {
    kind: &'static str,
    /// On a lane: its id, metres along it, and metres to the right of its middle.
    lane: String,
    position: f64,
    right: f64,
    /// Corners of a polygon instead.
    outline: Vec<Point>,
    params: Vec<(&'static str, String)>,
}

impl Drawn {
    fn with(mut self, params: &[(&'static str, &str)]) -> Self {
        self.params.extend(params.iter().map(|(key, value)| (*key, (*value).to_string())));
        self
    }
}

/// The way that a template is put on.
struct Stretch<'a> {
    network: &'a Network,
    route: &'a Route,
    /// The lane that the ego starts on, if the template's things go on that lane whatever the route does.
    start: Option<LanePosition>,
}

impl Stretch<'_> {
    fn at(&self, way: f64) -> (LaneId, f64) {
        if let Some(start) = self.start {
            return (start.lane, (start.s + way).min(self.network.lane(start.lane).shape.length()));
        }
        let at = self.route.at(way.min(self.route.length()));
        let lane = self.network.lane(at.lane);
        (at.lane, lane.shape.project(at.pose.xy()).s)
    }

    /// How far right of the first lane's middle the kerb is (m).
    fn kerb(&self) -> f64 {
        let (lane, _) = self.at(0.0);
        let edge = self.network.edge(self.network.lane(lane).edge);
        let lanes = edge.lanes.iter().map(|l| self.network.lane(*l));
        let lower =
            lanes.filter(|l| l.index < self.network.lane(lane).index && l.permissions.allows(EGO_CLASS));
        0.5 * self.network.lane(lane).width + lower.map(|l| l.width).sum::<f64>() + 0.6
    }

    fn signal(&self) -> Option<f64> {
        let signalled = |l: &&sumo_network::network::RouteLink| self.network.link(l.link).signal.is_some();
        self.route.links.iter().find(signalled).map(|l| l.stop_s)
    }

    fn point(&self, kind: &'static str, way: f64, right: f64) -> Drawn {
        let (lane, s) = self.at(way);
        let lane = self.network.lane(lane);
        let (position, id) = (lane.lane_position(s), lane.id.clone());
        Drawn { kind, lane: id, position, right, outline: Vec::new(), params: Vec::new() }
    }

    /// A rectangle over the lane, `length` (m) long.
    fn area(&self, kind: &'static str, way: f64, length: f64) -> Drawn {
        let (lane, s) = self.at(way);
        let lane = self.network.lane(lane);
        let half = 0.5 * lane.width - 0.1;
        let corner =
            |s: f64, left: f64| lane.shape.at(s.min(lane.shape.length())).to_world(Vector::new(0.0, left));
        let outline =
            vec![corner(s, half), corner(s, -half), corner(s + length, -half), corner(s + length, half)];
        Drawn { outline, ..self.point(kind, way, 0.0) }
    }
}

/// Random draws before placing a template fails.
const DRAWS: u64 = 400;
/// Way of an event's scenario along one road (m), and where the ego starts on it.
const ROAD: f64 = 190.0;
const START: f64 = 8.0;
/// How far before its event the ego has to be on the free lane (m).
const PASS: f64 = 35.0;
/// Where the event is, as the templates have it (m of way).
const EVENT: f64 = 110.0;

impl Template {
    /// Finds a place on the net, by `seed`.
    fn place(&self, network: &Network, seed: u64) -> Result<Placement, TemplateError> {
        let no = |why: String| TemplateError::NoPlace { template: self.name, why };
        match self.place {
            Place::Task => Ok(Places::default().draw(network, self.task, seed)?),
            Place::Signal => {
                let places = Places::default();
                for draw in 0..DRAWS {
                    let placement = places.draw(network, TaskKind::Navigation, seed + draw)?;
                    let route = placement.route(network)?;
                    let stretch = Stretch { network, route: &route, start: None };
                    if stretch.signal().is_some_and(|stop| (40.0..300.0).contains(&stop)) {
                        return Ok(placement);
                    }
                }
                Err(no(format!(
                    "none of {DRAWS} routes leads over a signal; wad-cosim net enrich adds signals"
                )))
            }
            Place::Road { .. } | Place::Street => {
                let lanes = if let Place::Road { lanes } = self.place { lanes } else { 1 };
                let mut roads: Vec<(LaneId, LaneId)> = Vec::new();
                for edge in network.edges.iter().filter(|e| e.kind == EdgeKind::Normal) {
                    let open: Vec<LaneId> = edge
                        .lanes
                        .iter()
                        .copied()
                        .filter(|l| network.lane(*l).permissions.allows(EGO_CLASS))
                        .collect();
                    let (Some(&first), Some(&last)) = (open.first(), open.last()) else { continue };
                    let walkers = |l: &LaneId| network.lane(*l).permissions.allows(VehicleClass::Pedestrian);
                    if self.place == Place::Street && !edge.lanes.iter().any(walkers) {
                        continue;
                    }
                    if open.len() < lanes || open.iter().any(|l| network.lane(*l).shape.length() < ROAD) {
                        continue;
                    }
                    roads.push((first, if lanes > 1 { open[1] } else { last.min(first) }));
                }
                if roads.is_empty() {
                    return Err(no(format!(
                        "no road without a junction is {ROAD} m long and has {lanes} or more lanes for cars"
                    )));
                }
                let (lane, other) = roads[(seed % roads.len() as u64) as usize];
                let end = network.lane(other).shape.length() - 4.0;
                let spot = |lane: LaneId, s: f64| Spot::at(network, LanePosition { lane, s });
                let pass = if lanes > 1 { vec![spot(other, START + EVENT - PASS)] } else { Vec::new() };
                let to = if self.task == TaskKind::Obstacle { lane } else { other };
                Ok(Placement { from: spot(lane, START), to: spot(to, end), via: pass, obstacle: None })
            }
        }
    }
}

/// A scenario's net: the net and its polygons, as the configuration names them.
#[derive(Clone, Debug)]
pub struct Base<'a> {
    /// The network that the net file holds.
    pub network: &'a Network,
    /// Path of the net, for `net-file`.
    pub net: String,
    /// Paths of polygons and points, for `additional-files`.
    pub additional: Vec<String>,
}

/// Writes a scenario into `folder`, which must not be there yet. Returns its `.sumocfg`.
///
/// # Errors
/// The net has no place for it, or the folder cannot be written.
pub fn create(
    folder: &Path,
    template: &Template,
    base: &Base<'_>,
    seed: u64,
) -> Result<PathBuf, TemplateError> {
    let name = folder.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_string();
    if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-')) {
        return Err(TemplateError::Name { name });
    }
    let network = base.network;
    let placement = template.place(network, seed)?;
    let route = placement.route(network)?;
    let start = match template.place {
        Place::Road { .. } | Place::Street => Some(placement.from.on(network)?),
        Place::Task | Place::Signal => None,
    };
    let stretch = Stretch { network, route: &route, start };
    let drawn = (template.draw)(&stretch);
    let ego = trip(template, network, &placement, &route)?;
    let fail = |path: &Path, source| TemplateError::Write { path: path.to_path_buf(), source };
    std::fs::create_dir_all(folder).map_err(|source| fail(folder, source))?;
    let config = folder.join(format!("{name}.sumocfg"));
    for (path, text) in [
        (config.clone(), sumocfg(&name, base)),
        (folder.join(format!("{name}.rou.xml")), ego),
        (folder.join(format!("{name}.add.xml")), additional(&drawn)),
    ] {
        std::fs::write(&path, text).map_err(|source| fail(&path, source))?;
    }
    Ok(config)
}

fn sumocfg(name: &str, base: &Base<'_>) -> String {
    let mut files = base.additional.clone();
    files.push(format!("{name}.add.xml"));
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\n\
         <sumoConfiguration xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xsi:noNamespaceSchemaLocation=\"http://sumo.dlr.de/xsd/sumoConfiguration.xsd\">\n\n    \
         <input>\n        <net-file value=\"{}\"/>\n        <route-files value=\"{name}.rou.xml\"/>\n        \
         <additional-files value=\"{}\"/>\n    </input>\n\n</sumoConfiguration>\n",
        base.net,
        files.join(",")
    )
}

const SCHEMA: &str = "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xsi:noNamespaceSchemaLocation=\"http://sumo.dlr.de/xsd/";

fn trip(
    template: &Template,
    network: &Network,
    placement: &Placement,
    route: &Route,
) -> Result<String, TemplateError> {
    let (from, to) = (placement.from.on(network)?, placement.to.on(network)?);
    let ego = EgoParams::default();
    let edge = |lane: LaneId| network.edge(network.lane(lane).edge).id.as_str();
    let lane = network.lane(from.lane);
    // SUMO counts to the front bumper.
    let depart = lane.lane_position(from.s + 0.5 * ego.length);
    let arrive = network.lane(to.lane).lane_position(to.s);
    let mut params = vec![
        (DESCRIPTION.to_string(), template.about.to_string()),
        ("wad.task".to_string(), template.task.name().to_string()),
    ];
    if !placement.via.is_empty() {
        let via: Vec<String> = placement
            .via
            .iter()
            .map(|spot| {
                let at = spot.on(network)?;
                Ok(format!("{}@{:.2}", spot.lane, network.lane(at.lane).lane_position(at.s)))
            })
            .collect::<Result<_, TaskError>>()?;
        params.push(("wad.via".to_string(), via.join(" ")));
    }
    params.push(("wad.weather".to_string(), "ClearNoon".to_string()));
    params.push((
        "wad.traffic".to_string(),
        match template.task.traffic() {
            crate::traffic::TrafficSpec::Empty => "empty".to_string(),
            other => other.to_string(),
        },
    ));
    if template.task == TaskKind::Navigation {
        let seconds = (route.length() / (10.0 / 3.6)).ceil().max(60.0);
        params.push(("wad.time_limit".to_string(), format!("{seconds}")));
    }
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\n<routes {SCHEMA}routes_file.xsd\">\n    \
         <!-- VTypes -->\n    <vType id=\"ego\" length=\"{}\" width=\"{}\" height=\"{}\" color=\"220,30,30\"/>\n    \
         <!-- Vehicles, persons and containers (sorted by depart) -->\n    \
         <trip id=\"ego\" type=\"ego\" depart=\"0.00\" departLane=\"{}\" departPos=\"{depart:.2}\" arrivalLane=\"{}\" arrivalPos=\"{arrive:.2}\" from=\"{}\" to=\"{}\">\n",
        ego.length,
        ego.width,
        ego.height,
        lane.index,
        network.lane(to.lane).index,
        edge(from.lane),
        edge(to.lane),
    );
    for (key, value) in &params {
        let _ = writeln!(text, "        <param key=\"{key}\" value=\"{value}\"/>");
    }
    text.push_str("    </trip>\n</routes>\n");
    Ok(text)
}

fn additional(drawn: &[Drawn]) -> String {
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\n<additional {SCHEMA}additional_file.xsd\">\n    <!-- Shapes -->\n"
    );
    for (number, thing) in drawn.iter().enumerate() {
        let id = format!("{}_{number}", thing.kind.rsplit('.').next().unwrap_or(thing.kind));
        let params: String = thing
            .params
            .iter()
            .map(|(key, value)| format!("        <param key=\"{key}\" value=\"{value}\"/>\n"))
            .collect();
        let kind = thing.kind;
        let (tag, open) = if thing.outline.is_empty() {
            let right =
                if thing.right == 0.0 { String::new() } else { format!(" posLat=\"{:.2}\"", -thing.right) };
            (
                "poi",
                format!(
                    "<poi id=\"{id}\" color=\"{}\" layer=\"10.00\" type=\"{kind}\" lane=\"{}\" pos=\"{:.2}\"{right}",
                    colour(kind),
                    thing.lane,
                    thing.position
                ),
            )
        } else {
            let shape: Vec<String> = thing.outline.iter().map(|p| format!("{:.2},{:.2}", p.x, p.y)).collect();
            (
                "poly",
                format!(
                    "<poly id=\"{id}\" type=\"{kind}\" color=\"{}\" fill=\"1\" layer=\"5.00\" shape=\"{}\"",
                    colour(kind),
                    shape.join(" ")
                ),
            )
        };
        if params.is_empty() {
            let _ = writeln!(text, "    {open}/>");
        } else {
            let _ = writeln!(text, "    {open}>\n{params}    </{tag}>");
        }
    }
    text.push_str("</additional>\n");
    text
}

fn colour(kind: &str) -> &'static str {
    match kind.split('.').next() {
        Some("event") => "255,0,255",
        Some("roadworks") => "255,128,0",
        Some("bench") => "128,64,0",
        _ => "255,128,0",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_have_names_of_their_own_and_near_ones_are_offered() {
        for (i, template) in TEMPLATES.iter().enumerate() {
            assert!(TEMPLATES[..i].iter().all(|other| other.name != template.name), "{}", template.name);
        }
        let error = find("acident").unwrap_err().to_string();
        assert!(error.contains("did you mean accident?"), "{error}");
        assert!(find("lane-closed").is_ok());
    }
}
