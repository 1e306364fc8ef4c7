//! The elements of a `.net.xml`, as they stand in the file: names are still strings.

use super::error::NetworkError;
use super::permissions::Permissions;
use super::programs::SignalProgram;
use super::xml::{Element, Step, Walk};
use nalgebra::Point3;
use std::borrow::Cow;
use std::path::Path;

/// `<edge>`.
pub(super) struct RawEdge {
    pub id: String,
    pub function: String,
    pub from: Option<String>,
    pub to: Option<String>,
    pub priority: i32,
    pub edge_type: String,
    pub name: String,
    pub crossing_edges: Vec<String>,
    pub lanes: Vec<RawLane>,
    pub position: u64,
}

/// `<lane>`.
pub(super) struct RawLane {
    pub id: String,
    pub speed: f64,
    pub length: f64,
    pub width: Option<f64>,
    pub permissions: Permissions,
    pub change_left: Permissions,
    pub change_right: Permissions,
    pub shape: Vec<Point3<f64>>,
    pub outline: Vec<Point3<f64>>,
}

/// `<junction>` with its `<request>`s.
pub(super) struct RawJunction {
    pub id: String,
    pub kind: String,
    pub point: Point3<f64>,
    pub shape: Vec<Point3<f64>>,
    pub incoming_lanes: Vec<String>,
    pub requests: Vec<RawRequest>,
    pub position: u64,
}

/// `<request>`: bit strings that are read from the right.
pub(super) struct RawRequest {
    pub index: usize,
    pub response: String,
    pub foes: String,
}

/// `<connection>`.
pub(super) struct RawConnection {
    pub from: String,
    pub to: String,
    pub from_lane: usize,
    pub to_lane: usize,
    pub via: Option<String>,
    pub traffic_light: Option<String>,
    pub link_index: Option<usize>,
    pub direction: u8,
    pub state: char,
    pub position: u64,
}

/// `<tlLogic>`: its id, the length of its longest state, and its program.
pub(super) struct RawTrafficLight {
    pub id: String,
    pub signals: usize,
    pub program: SignalProgram,
}

/// The whole file.
#[derive(Default)]
pub(super) struct RawNet {
    pub left_hand: bool,
    pub edges: Vec<RawEdge>,
    pub junctions: Vec<RawJunction>,
    pub connections: Vec<RawConnection>,
    pub traffic_lights: Vec<RawTrafficLight>,
    /// Edge ids of each roundabout's ring.
    pub roundabouts: Vec<Vec<String>>,
}

/// Reads a net's text, which came from `path`.
pub(super) fn parse(path: &Path, text: &str) -> Result<RawNet, NetworkError> {
    let mut walk = Walk::new(path, text);
    let mut net = RawNet::default();
    let mut root_seen = false;
    // The child of the root that the walk is in.
    let mut inside = Inside::Other;
    while let Some(step) = walk.next()? {
        let Step::Open(element) = step else { continue };
        let at = At { path, walk: &walk, element: &element };
        match (element.depth, element.name()) {
            (0, "net") => {
                root_seen = true;
                net.left_hand = matches!(element.read(["lefthand"]), [Some(v)] if is_true(&v));
            }
            (0, other) => {
                return Err(NetworkError::NotANet { path: path.to_owned(), found: other.to_owned() });
            }
            (1, name) => {
                inside = match name {
                    "edge" => {
                        net.edges.push(edge(&at)?);
                        Inside::Edge
                    }
                    "junction" => {
                        net.junctions.push(junction(&at)?);
                        Inside::Junction
                    }
                    "tlLogic" => {
                        let [id, kind, offset] = element.read(["id", "type", "offset"]);
                        let id = at.need(id, "tlLogic", "", "id")?;
                        let program = SignalProgram::new(kind.as_deref(), offset.as_deref());
                        net.traffic_lights.push(RawTrafficLight { id, signals: 0, program });
                        Inside::TrafficLight
                    }
                    "roundabout" => {
                        let [edges] = element.read(["edges"]);
                        let ids = edges.iter().flat_map(|e| e.split_whitespace()).map(str::to_owned);
                        net.roundabouts.push(ids.collect());
                        Inside::Other
                    }
                    "connection" => {
                        net.connections.push(connection(&at)?);
                        Inside::Other
                    }
                    _ => Inside::Other,
                }
            }
            (2, "lane") if inside == Inside::Edge => {
                let lane = lane(&at)?;
                if let Some(edge) = net.edges.last_mut() {
                    edge.lanes.push(lane);
                }
            }
            (2, "request") if inside == Inside::Junction => {
                let request = request(&at)?;
                if let Some(junction) = net.junctions.last_mut() {
                    junction.requests.push(request);
                }
            }
            (2, "phase") if inside == Inside::TrafficLight => {
                let [state, duration] = element.read(["state", "duration"]);
                if let (Some(state), Some(light)) = (state, net.traffic_lights.last_mut()) {
                    light.signals = light.signals.max(state.len());
                    light.program.push(&state, duration.as_deref());
                }
            }
            _ => {}
        }
    }
    if root_seen {
        Ok(net)
    } else {
        Err(NetworkError::Xml {
            path: path.to_owned(),
            line: 1,
            message: "the file has no element at all".to_owned(),
        })
    }
}

#[derive(PartialEq)]
enum Inside {
    Edge,
    Junction,
    TrafficLight,
    Other,
}

/// Where an attribute stands, for errors.
struct At<'a> {
    path: &'a Path,
    walk: &'a Walk<'a>,
    element: &'a Element<'a>,
}

type Value<'a> = Option<Cow<'a, str>>;

impl At<'_> {
    fn line(&self) -> usize {
        self.walk.line_of(self.element.position)
    }

    fn need(
        &self,
        value: Value<'_>,
        element: &'static str,
        id: &str,
        attribute: &'static str,
    ) -> Result<String, NetworkError> {
        value.map(Cow::into_owned).ok_or_else(|| NetworkError::Missing {
            path: self.path.to_owned(),
            line: self.line(),
            element,
            id: id.to_owned(),
            attribute,
        })
    }

    fn bad(
        &self,
        element: &'static str,
        attribute: &'static str,
        value: &str,
        expected: &'static str,
    ) -> NetworkError {
        NetworkError::BadValue {
            path: self.path.to_owned(),
            line: self.line(),
            element,
            attribute,
            value: value.chars().take(80).collect(),
            expected,
        }
    }

    fn number(
        &self,
        element: &'static str,
        attribute: &'static str,
        value: &str,
    ) -> Result<f64, NetworkError> {
        finite(value).ok_or_else(|| self.bad(element, attribute, value, "a finite number"))
    }

    fn count(
        &self,
        element: &'static str,
        attribute: &'static str,
        value: &str,
    ) -> Result<usize, NetworkError> {
        value.trim().parse().map_err(|_| self.bad(element, attribute, value, "a whole number from 0"))
    }

    fn shape(
        &self,
        element: &'static str,
        attribute: &'static str,
        value: Value<'_>,
    ) -> Result<Vec<Point3<f64>>, NetworkError> {
        let Some(value) = value else { return Ok(Vec::new()) };
        points(&value).ok_or_else(|| {
            self.bad(element, attribute, &value, "points `x,y` or `x,y,z` separated by blanks")
        })
    }
}

/// Largest accepted coordinate and length (m): more does not exist on Earth.
const LARGEST: f64 = 1e9;

fn finite(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|v: &f64| v.abs() <= LARGEST)
}

/// SUMO's `x,y x,y,z ...`.
pub(super) fn points(text: &str) -> Option<Vec<Point3<f64>>> {
    text.split_ascii_whitespace()
        .map(|point| {
            let mut numbers = point.split(',');
            let x = finite(numbers.next()?)?;
            let y = finite(numbers.next()?)?;
            let z = numbers.next().map_or(Some(0.0), finite)?;
            numbers.next().is_none().then(|| Point3::new(x, y, z))
        })
        .collect()
}

/// SUMO's words for true.
pub(super) fn is_true(text: &str) -> bool {
    matches!(text.trim().to_ascii_lowercase().as_str(), "1" | "true" | "yes" | "on" | "x" | "t")
}

fn words(value: Value<'_>) -> Vec<String> {
    value.map_or_else(Vec::new, |v| v.split_ascii_whitespace().map(str::to_owned).collect())
}

fn edge(at: &At<'_>) -> Result<RawEdge, NetworkError> {
    let [id, function, from, to, priority, edge_type, name, crossing_edges] =
        at.element.read(["id", "function", "from", "to", "priority", "type", "name", "crossingEdges"]);
    Ok(RawEdge {
        id: at.need(id, "edge", "", "id")?,
        function: function.unwrap_or_default().into_owned(),
        from: from.map(Cow::into_owned),
        to: to.map(Cow::into_owned),
        priority: priority.and_then(|p| p.trim().parse().ok()).unwrap_or(-1),
        edge_type: edge_type.unwrap_or_default().into_owned(),
        name: name.unwrap_or_default().into_owned(),
        crossing_edges: words(crossing_edges),
        lanes: Vec::new(),
        position: at.element.position,
    })
}

fn lane(at: &At<'_>) -> Result<RawLane, NetworkError> {
    let [id, speed, length, width, allow, disallow, left, right, shape, outline] = at.element.read([
        "id",
        "speed",
        "length",
        "width",
        "allow",
        "disallow",
        "changeLeft",
        "changeRight",
        "shape",
        "outlineShape",
    ]);
    let id = at.need(id, "lane", "", "id")?;
    let speed = at.need(speed, "lane", &id, "speed")?;
    let length = at.need(length, "lane", &id, "length")?;
    let width = match width {
        Some(w) => Some(at.number("lane", "width", &w)?).filter(|w| *w > 0.0),
        None => None,
    };
    let shape = at.shape("lane", "shape", shape)?;
    if shape.is_empty() {
        return Err(at.bad("lane", "shape", "", "at least one point"));
    }
    Ok(RawLane {
        speed: at.number("lane", "speed", &speed)?.max(0.0),
        length: at.number("lane", "length", &length)?.max(0.0),
        width,
        permissions: Permissions::from_attributes(allow.as_deref(), disallow.as_deref()),
        change_left: Permissions::from_attributes(left.as_deref(), None),
        change_right: Permissions::from_attributes(right.as_deref(), None),
        shape,
        outline: at.shape("lane", "outlineShape", outline)?,
        id,
    })
}

fn junction(at: &At<'_>) -> Result<RawJunction, NetworkError> {
    let [id, kind, x, y, z, incoming, shape] =
        at.element.read(["id", "type", "x", "y", "z", "incLanes", "shape"]);
    let id = at.need(id, "junction", "", "id")?;
    let x = at.need(x, "junction", &id, "x")?;
    let y = at.need(y, "junction", &id, "y")?;
    let z = match z {
        Some(z) => at.number("junction", "z", &z)?,
        None => 0.0,
    };
    Ok(RawJunction {
        kind: kind.unwrap_or_default().into_owned(),
        point: Point3::new(at.number("junction", "x", &x)?, at.number("junction", "y", &y)?, z),
        shape: at.shape("junction", "shape", shape)?,
        incoming_lanes: words(incoming),
        requests: Vec::new(),
        position: at.element.position,
        id,
    })
}

fn request(at: &At<'_>) -> Result<RawRequest, NetworkError> {
    let [index, response, foes] = at.element.read(["index", "response", "foes"]);
    let index = at.need(index, "request", "", "index")?;
    Ok(RawRequest {
        index: at.count("request", "index", &index)?,
        response: response.unwrap_or_default().into_owned(),
        foes: foes.unwrap_or_default().into_owned(),
    })
}

fn connection(at: &At<'_>) -> Result<RawConnection, NetworkError> {
    let [from, to, from_lane, to_lane, via, light, link_index, direction, state] =
        at.element.read(["from", "to", "fromLane", "toLane", "via", "tl", "linkIndex", "dir", "state"]);
    let from = at.need(from, "connection", "", "from")?;
    let to = at.need(to, "connection", &from, "to")?;
    let from_lane = at.need(from_lane, "connection", &from, "fromLane")?;
    let to_lane = at.need(to_lane, "connection", &from, "toLane")?;
    let link_index = match &link_index {
        // SUMO writes -1 for a connection that its traffic light leaves alone.
        Some(i) if i.trim().starts_with('-') => None,
        Some(i) => Some(at.count("connection", "linkIndex", i)?),
        None => None,
    };
    Ok(RawConnection {
        from_lane: at.count("connection", "fromLane", &from_lane)?,
        to_lane: at.count("connection", "toLane", &to_lane)?,
        via: via.map(Cow::into_owned).filter(|v| !v.is_empty()),
        traffic_light: light.map(Cow::into_owned).filter(|v| !v.is_empty()),
        link_index,
        direction: direction.and_then(|d| d.bytes().next()).unwrap_or(b's'),
        state: state.and_then(|s| s.chars().next()).unwrap_or('M'),
        position: at.element.position,
        from,
        to,
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::{net, parsed, text};
    use super::super::*;
    use std::path::Path;

    #[test]
    fn elements_become_what_they_mean() {
        let network = net();
        assert_eq!((network.edges.len(), network.lanes.len(), network.links.len()), (5, 7, 6));
        let edge = network.edge(network.edge_by_id("ab").unwrap());
        assert_eq!((edge.name.as_str(), edge.priority, edge.kind), ("Main Street & Co", 2, EdgeKind::Normal));
        let lane = |id: &str| network.lane(network.lane_by_id(id).unwrap());
        assert_eq!((lane("ab_0").width, lane("bl_0").width), (3.2, 3.0));
        assert!(lane("br_0").permissions.allows(VehicleClass::Bus));
        assert!(!lane("br_0").permissions.allows(VehicleClass::Passenger));
        assert_eq!(lane("bc_1").lane_position(100.0), 200.0);
        assert_eq!(lane("bc_1").arc_length(200.0), 100.0);
        let light = network.traffic_light(network.traffic_light_by_id("light").unwrap());
        assert_eq!((light.signals, light.links.len()), (3, 3));
        assert_eq!(network.bounds, (Point::new(-50.0, -300.0), Point::new(650.0, 300.0)));
        assert!(!network.left_hand && !network.has_pedestrian_network());
    }

    #[test]
    fn the_last_character_of_a_request_is_link_0() {
        let network = net();
        let left = &network.links[3];
        assert_eq!((left.direction, left.request_index), (LinkDirection::Left, Some(3)));
        assert_eq!((&left.must_yield_to[..], &left.foes[..]), (&[LinkId(0)][..], &[LinkId(0)][..]));
        assert_eq!(network.links[0].foes, [LinkId(3)]);
        assert!(network.links[0].must_yield_to.is_empty());
        assert_eq!(network.links[1].signal, None);
        assert_eq!(left.signal.unwrap().index, 2);
    }

    #[test]
    fn each_fault_has_its_own_error() {
        let good = text("");
        let error = |text: &str| parsed(text).unwrap_err();
        assert!(
            matches!(error("<configuration/>"), NetworkError::NotANet { found, .. } if found == "configuration")
        );
        assert!(matches!(error("no xml at all"), NetworkError::Xml { line: 1, .. }));
        assert!(matches!(error(""), NetworkError::Xml { .. }));
        let crossed = error("<net>\n<edge id=\"e\"></lane>\n</net>");
        assert!(matches!(crossed, NetworkError::Xml { line: 2, .. }), "{crossed}");
        let cut = &good[..good.find("<junction id=\"C\"").unwrap()];
        assert!(matches!(error(cut), NetworkError::Truncated { element, .. } if element == "net"));
        let cut = &good[..good.find("ab_1").unwrap()];
        assert!(matches!(error(cut), NetworkError::Truncated { element, line: 6, .. } if element == "edge"));
        let bad = error(&good.replace("shape=\"310,-1.6 ", "shape=\"310 -1.6 "));
        assert!(matches!(bad, NetworkError::BadValue { attribute: "shape", line: 9, .. }), "{bad}");
        for value in ["nan", "inf", "1e300", "ten"] {
            let bad = error(&good.replace("width=\"3\"", &format!("width=\"{value}\"")));
            assert!(matches!(bad, NetworkError::BadValue { attribute: "width", .. }), "{bad}");
        }
        let missing = error(&good.replace("speed=\"10\" length=\"960\"", "length=\"960\""));
        assert!(matches!(missing, NetworkError::Missing { attribute: "speed", .. }), "{missing}");
        let dangling = [
            ("to=\"C\"", "to=\"q\"", "junction"),
            ("from=\"ca\" to", "from=\"q\" to", "edge"),
            ("incLanes=\"bc_0\"", "incLanes=\"q\"", "lane"),
        ];
        for (good_part, bad_part, which) in dangling {
            let text = good.replacen(good_part, bad_part, 1);
            let found = error(&text);
            assert!(
                matches!(found, NetworkError::DanglingReference { kind, .. } if kind == which),
                "{found}"
            );
        }
        let lane = error(&good.replace("fromLane=\"1\" toLane=\"1\"", "fromLane=\"1\" toLane=\"9999999\""));
        assert!(matches!(lane, NetworkError::DanglingReference { kind: "lane", .. }), "{lane}");
        let absent = Network::load(Path::new("/no/such.net.xml")).unwrap_err();
        assert!(matches!(absent, NetworkError::Io { .. }));
    }

    #[test]
    fn gzip_is_told_by_its_first_bytes_and_damage_is_an_error() {
        use std::io::Write;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plain.net.xml");
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(text("").as_bytes()).unwrap();
        let packed = encoder.finish().unwrap();
        std::fs::write(&path, &packed).unwrap();
        assert_eq!(Network::load(&path).unwrap().lanes.len(), 7);
        std::fs::write(&path, &packed[..packed.len() / 2]).unwrap();
        assert!(matches!(Network::load(&path), Err(NetworkError::Compressed { .. })));
    }

    #[test]
    fn latin_1_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("latin.net.xml");
        let text = text("").replace("Main Street", "Hauptstra\u{df}e");
        let bytes: Vec<u8> = text.chars().map(|c| u8::try_from(c as u32).unwrap()).collect();
        std::fs::write(&path, bytes).unwrap();
        assert!(Network::load(&path).unwrap().edges[0].name.starts_with("Hauptstra\u{df}e"));
    }

    #[test]
    fn a_net_without_lanes_for_a_class_says_so() {
        let network = parsed("<net></net>").unwrap();
        let error = network.require_drivable(VehicleClass::Passenger).unwrap_err();
        assert!(error.to_string().starts_with("no drivable lane for class passenger"), "{error}");
        assert!(network.largest_component(VehicleClass::Passenger).is_empty());
        assert_eq!(net().require_drivable(VehicleClass::Bus).unwrap().len(), 7);
    }
}
