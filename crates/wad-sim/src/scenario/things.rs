//! A scenario's obstacles and events, read from points and polygons by type.

mod thing;

pub use thing::{Closure, Kind, Leader, ObjectShape, Thing, Trigger};

use super::params::{PREFIX, Reader};
use super::problem::Problem;
use super::xml::Element;
use crate::destination::EGO_CLASS;
use crate::suggest::{meant, near};
use crate::traffic::{FLEET, Model, WALKERS, Walker};
use sumo_network::geometry::{Point, Vector, polygon_contains};
use sumo_network::network::{
    EdgeKind, LanePosition, NearLane, Network, PointOfInterest, Polygon, Route, Shapes,
};
use sumo_network::world::ActorKind;
use wad_vehicle::EgoParams;

/// Types of points that a scenario may use.
pub const POINTS: &[&str] = &[
    "obstacle.car",
    "obstacle.van",
    "obstacle.truck",
    "obstacle.bus",
    "obstacle.motorcycle",
    "obstacle.bicycle",
    "obstacle.person",
    "obstacle.barrier",
    "obstacle.cone",
    "bench",
    "event.pedestrian",
    "event.brake",
    "event.accident",
    "event.signal_off",
    "event.lane_closed",
];

/// Types of polygons that a scenario may use.
pub const POLYGONS: &[&str] = &["roadworks"];

/// Vehicles by the name that an author gives, of the fleet's models.
pub const VEHICLES: &[&str] = &["car", "van", "truck", "bus", "motorcycle", "bicycle"];

/// The model that `name` of [`VEHICLES`] means.
fn model(name: &str) -> &'static Model {
    let kind = match name {
        "van" => ActorKind::Van,
        "truck" => ActorKind::Truck,
        "bus" => ActorKind::Bus,
        "motorcycle" => ActorKind::Motorcycle,
        "bicycle" => ActorKind::Bicycle,
        _ => ActorKind::Car,
    };
    // A saloon rather than the fleet's smallest.
    let usual = |m: &&Model| m.kind == kind && (kind != ActorKind::Car || m.length > 4.5);
    FLEET.iter().find(usual).unwrap_or(&FLEET[0])
}

fn walker(name: &str) -> &'static Walker {
    WALKERS.iter().find(|w| w.id.ends_with(name)).unwrap_or(&WALKERS[0])
}

/// How far from a lane for cars a thing may lie (m): events in it, pedestrians and benches beside it.
const ON_ROAD: f64 = 2.5;
const BESIDE_ROAD: f64 = 12.0;
/// How far a light may be from its point (m).
const NEAR_LIGHT: f64 = 60.0;
/// How near an event's point must come to the ego's route (m), beyond what triggers it.
const OF_ROUTE: f64 = 40.0;

/// Reads the points and polygons; `route` is the ego's, where there is one.
pub fn read(
    elements: &[Element],
    network: &Network,
    route: Option<&Route>,
    problems: &mut Vec<Problem>,
) -> Vec<Thing> {
    let mut things: Vec<Thing> = Vec::new();
    for element in elements.iter().filter(|e| matches!(e.tag.as_str(), "poi" | "poly")) {
        let point = element.tag == "poi";
        let (own, other) = if point { (POINTS, POLYGONS) } else { (POLYGONS, POINTS) };
        let kind = element.get("type").unwrap_or_default();
        if !own.contains(&kind) {
            if stranger(element, kind, own, other, problems) && point {
                // Its place too, as of the type that is meant: every mistake is told at once.
                let meant = near(kind, own.iter().copied()).first().copied().unwrap_or(kind);
                place(&mut Reader { element, problems }, meant, network);
            }
            continue;
        }
        if things.iter().any(|thing| thing.id == element.id()) {
            problems.push(element.problem("another one has the same id", "rename one of them"));
            continue;
        }
        let mut reader = Reader { element, problems };
        things.extend(if point {
            read_point(&mut reader, kind, elements, network, route)
        } else {
            read_polygon(&mut reader, network)
        });
    }
    things
}

/// An unknown type: it may be a misspelt one, which is answered, and it may carry our parameters.
fn stranger(
    element: &Element,
    kind: &str,
    own: &[&str],
    other: &[&str],
    problems: &mut Vec<Problem>,
) -> bool {
    let a = if element.tag == "poi" { "a point" } else { "a polygon" };
    if other.contains(&kind) {
        let fix =
            if element.tag == "poi" { "draw it as a polygon" } else { "draw it as a point of interest" };
        problems.push(element.problem(format!("type `{kind}` does not go with {a}"), fix));
    } else if ["event", "obstacle"].iter().any(|word| kind.starts_with(word))
        || kind.len() > 3 && !near(kind, own.iter().copied()).is_empty()
    {
        problems.push(element.problem(format!("unknown type `{kind}`"), meant(kind, own)));
        return true;
    } else if element.params.iter().any(|p| p.key.starts_with(PREFIX)) {
        let what = format!("it has wad.* parameters, but its type `{kind}` is unknown");
        problems.push(element.problem(what, meant(kind, own)));
    }
    false
}

/// The element's own shape, read as SUMO does.
fn shape(element: &Element, network: &Network) -> (Option<PointOfInterest>, Option<Polygon>) {
    let attributes: String = element
        .attributes
        .iter()
        .map(|(key, value)| format!(" {key}=\"{}\"", quick_xml::escape::escape(value.as_str())))
        .collect();
    let text = format!("<additional><{}{attributes}/></additional>", element.tag);
    let shapes = Shapes::from_xml(&element.file, &text, network).unwrap_or_default();
    (shapes.points.into_iter().next(), shapes.polygons.into_iter().next())
}

/// Lanes of roads that cars may use, near a point, nearest first.
fn roads(network: &Network, point: Point, radius: f64) -> Vec<NearLane> {
    let mut near = network.lanes_near(point, None, radius);
    near.retain(|n| {
        let lane = network.lane(n.lane);
        lane.permissions.allows(EGO_CLASS) && network.edge(lane.edge).kind == EdgeKind::Normal
    });
    near
}

fn read_point(
    reader: &mut Reader<'_>,
    kind: &str,
    elements: &[Element],
    network: &Network,
    route: Option<&Route>,
) -> Option<Thing> {
    let place = place(reader, kind, network);
    // Its parameters are read even if it has no place: every mistake is told at once.
    let kind = kind_of(reader, kind, elements, network, place, route);
    let (point, at) = place?;
    Some(Thing {
        id: reader.element.id().to_string(),
        kind: kind?,
        point,
        lane: at.lane,
        s: at.s,
        d: at.d,
        pose: network.lane(at.lane).shape.at(at.s),
    })
}

/// Where a point lies, and the lane that it belongs to.
fn place(reader: &mut Reader<'_>, kind: &str, network: &Network) -> Option<(Point, NearLane)> {
    let element = reader.element;
    let Some(found) = shape(element, network).0 else {
        let (what, fix) = match element.get("lane") {
            Some(lane) => (format!("its lane `{lane}` is not in the net"), "move it onto a lane of this net"),
            None => (
                "its position is not in the net's coordinates".to_string(),
                "draw it as a POI on a lane, or as a plain POI rather than one with longitude and latitude",
            ),
        };
        reader.wrong(what, fix);
        return None;
    };
    if let (Some(text), Some(lane)) =
        (element.get("pos"), element.get("lane").and_then(|l| network.lane_by_id(l)))
    {
        let length = network.lane(lane).length;
        if !text.parse::<f64>().is_ok_and(|p| p.abs() <= length + 0.01) {
            reader.wrong(
                format!("pos is `{text}`"),
                format!("expected metres from 0 to the lane's {length:.2}"),
            );
            return None;
        }
    }
    let reach = match kind {
        "event.signal_off" => NEAR_LIGHT,
        "event.pedestrian" | "bench" => BESIDE_ROAD,
        _ => ON_ROAD,
    };
    let near_roads = roads(network, found.position, reach.max(BESIDE_ROAD));
    let closest = near_roads.first().copied().filter(|n| n.distance <= reach);
    let Some(mut at) = closest else {
        let how_far = near_roads
            .first()
            .map_or("none is near".to_string(), |n| format!("the nearest is {:.1} m away", n.distance));
        reader.wrong(
            format!("it lies off the road ({how_far})"),
            format!("move it to within {reach:.1} m of a lane that cars may use"),
        );
        return None;
    };
    // A point that was put on a lane is on that lane.
    if let Some(named) = element.get("lane").and_then(|l| network.lane_by_id(l))
        && let Some(on) = near_roads.iter().find(|n| n.lane == named)
    {
        at = *on;
    }
    Some((found.position, at))
}

fn trigger(reader: &mut Reader<'_>, default: Option<f64>) -> Trigger {
    let distance = reader.optional("wad.distance", 0.0, 500.0, "metres");
    let time = reader.optional("wad.time", 0.0, 36_000.0, "seconds");
    Trigger { distance: distance.or(if time.is_none() { default } else { None }), time }
}

/// Complains of an event that the ego never comes near.
fn on_the_way(reader: &mut Reader<'_>, at: Option<Point>, trigger: &Trigger, route: Option<&Route>) {
    let (Some(at), Some(route)) = (at, route) else { return };
    let nearest = route.centre_line.project(at).distance;
    if nearest > trigger.distance.unwrap_or(0.0).max(OF_ROUTE) {
        reader.wrong(
            format!("the ego never comes near it: its route passes {nearest:.0} m away"),
            "move it to the ego's route, or lead the route past it with wad.via",
        );
    }
}

/// The obstacle of that type on a lane of this width (m).
fn obstacle(reader: &mut Reader<'_>, name: &str, lane_width: f64) -> Kind {
    let shape = match name {
        "barrier" => ObjectShape::Barrier,
        "cone" => ObjectShape::Cone,
        "person" => {
            reader.only(&["wad.person"]);
            return Kind::Person(walker(reader.choice("wad.person", &["adult", "child", "senior"], "adult")));
        }
        _ => {
            reader.only(&[]);
            return Kind::Vehicle(model(name));
        }
    };
    let usual = shape.sizes().2;
    if shape == ObjectShape::Cone {
        reader.only(&[]);
        return Kind::Object { shape, width: usual };
    }
    reader.only(&["wad.width"]);
    let width = reader.number("wad.width", usual.min(lane_width - 0.4), 0.2, 8.0, "metres");
    Kind::Object { shape, width }
}

/// Lane width (m) and speed limit (m/s) of a point that lies on no lane: they give defaults only.
const NO_LANE: (f64, f64) = (3.2, 13.9);

fn kind_of(
    reader: &mut Reader<'_>,
    kind: &str,
    elements: &[Element],
    network: &Network,
    place: Option<(Point, NearLane)>,
    route: Option<&Route>,
) -> Option<Kind> {
    let (point, at) = place.unzip();
    let lane = at.map(|at| network.lane(at.lane));
    let (width, speed_limit) = lane.map_or(NO_LANE, |lane| (lane.width, lane.speed_limit));
    let always = Trigger { distance: None, time: None };
    if let Some(name) = kind.strip_prefix("obstacle.") {
        return Some(obstacle(reader, name, width));
    }
    Some(match kind {
        "bench" => {
            reader.only(&[]);
            Kind::Bench
        }
        "event.pedestrian" => {
            reader.only(&["wad.person", "wad.speed", "wad.way", "wad.distance", "wad.time"]);
            let name = reader.choice("wad.person", &["adult", "child", "senior"], "adult");
            let speed = reader.number("wad.speed", 1.8, 0.2, 6.0, "metres a second");
            let way = reader.number("wad.way", at.map_or(0.0, |at| at.d.abs()) + 8.0, 0.5, 60.0, "metres");
            // Near enough for a surprise, far enough for an attentive driver to stop: 2.5 s at the limit.
            let trigger = trigger(reader, Some((2.5 * speed_limit).max(15.0)));
            on_the_way(reader, point, &trigger, route);
            walkable(reader, network);
            Kind::Pedestrian { walker: walker(name), speed, way, trigger }
        }
        "event.brake" => {
            reader.only(&["wad.vehicle", "wad.gap", "wad.deceleration", "wad.duration"]);
            let gap = reader.number("wad.gap", 15.0, 2.0, 90.0, "metres");
            let deceleration = reader.number("wad.deceleration", 7.0, 1.0, 10.0, "metres a second squared");
            let duration = reader.number("wad.duration", 4.0, 0.0, 600.0, "seconds");
            on_the_way(reader, point, &always, route);
            let text = reader.element.param("wad.vehicle").unwrap_or("car");
            let drawn = elements.iter().any(|e| {
                matches!(e.tag.as_str(), "trip" | "vehicle") && e.id() == text && e.get("type") != Some("ego")
            });
            let leader = if drawn {
                Leader::Drawn(text.to_string())
            } else {
                let name = reader.one_of("wad.vehicle", text, VEHICLES)?;
                let rear = 0.5 * EgoParams::default().length + gap;
                if let Some(route) = route.filter(|route| rear >= route.length()) {
                    reader.wrong(
                        format!(
                            "`wad.gap` is `{gap}`, and the ego's way is only {:.0} m long",
                            route.length()
                        ),
                        "choose a smaller gap, or move the ego's destination on",
                    );
                }
                Leader::Ahead { model: model(name), gap }
            };
            Kind::Brake { leader, deceleration, duration }
        }
        "event.accident" => {
            reader.only(&["wad.vehicles"]);
            on_the_way(reader, point, &always, route);
            let text = reader.element.param("wad.vehicles").unwrap_or("car,van").to_string();
            let names: Vec<&str> = text.split(',').map(str::trim).collect();
            let [first, second] = names.as_slice() else {
                reader.wrong(
                    format!("`wad.vehicles` is `{text}`"),
                    format!("expected two of {}, with a comma between them", VEHICLES.join(", ")),
                );
                return None;
            };
            let (first, second) = (
                reader.one_of("wad.vehicles", first, VEHICLES),
                reader.one_of("wad.vehicles", second, VEHICLES),
            );
            Kind::Accident([model(first?), model(second?)])
        }
        "event.signal_off" => {
            reader.only(&["wad.signal", "wad.distance", "wad.time"]);
            let trigger = trigger(reader, None);
            on_the_way(reader, point, &trigger, route);
            Kind::SignalOff { light: light(reader, network, point)?, trigger }
        }
        "event.lane_closed" => {
            reader.only(&["wad.length", "wad.distance", "wad.time"]);
            let rest = at.zip(lane).map(|(at, lane)| lane.shape.length() - at.s);
            let room = rest.map_or(f64::INFINITY, |rest| rest.max(1.0));
            let length = reader.number("wad.length", 30.0_f64.min(room), 1.0, 1000.0, "metres").min(room);
            let trigger = trigger(reader, None);
            on_the_way(reader, point, &trigger, route);
            let at = at?;
            let closure = Closure { at: LanePosition { lane: at.lane, s: at.s }, length };
            Kind::LaneClosed { closure, trigger }
        }
        _ => return None,
    })
}

/// Somewhere SUMO must let people walk, or it has no place to bring them in.
fn walkable(reader: &mut Reader<'_>, network: &Network) {
    if pedestrian_edge(network, Point::origin()).is_none() {
        reader.wrong(
            "the net has no lane for pedestrians, and SUMO brings people in on one",
            "add sidewalks to the net: wad-cosim net enrich",
        );
    }
}

/// The edge nearest to `point` on which people may walk, and a place on it (m).
pub fn pedestrian_edge(network: &Network, point: Point) -> Option<(&str, f64)> {
    let mut best: Option<(f64, &str, f64)> = None;
    for lane in &network.lanes {
        let edge = network.edge(lane.edge);
        if edge.kind != EdgeKind::Normal
            || !lane.permissions.allows(sumo_network::network::VehicleClass::Pedestrian)
        {
            continue;
        }
        let on = lane.shape.project(point);
        if best.is_none_or(|(distance, ..)| on.distance < distance) {
            best = Some((
                on.distance,
                &edge.id,
                lane.lane_position(on.s).clamp(0.0, (lane.length - 0.1).max(0.0)),
            ));
        }
    }
    best.map(|(_, edge, position)| (edge, position))
}

/// The light that is named, or the nearest.
fn light(reader: &mut Reader<'_>, network: &Network, point: Option<Point>) -> Option<String> {
    if let Some(name) = reader.element.param("wad.signal") {
        if network.traffic_light_by_id(name).is_some() {
            return Some(name.to_string());
        }
        let ids: Vec<&str> = network.traffic_lights.iter().map(|l| l.id.as_str()).collect();
        let close = near(name, ids.iter().copied());
        let fix = match (close.is_empty(), ids.is_empty()) {
            (false, _) => format!("did you mean {}?", close.join(" or ")),
            (true, true) => "the net has no traffic light; add some: wad-cosim net enrich".to_string(),
            (true, false) => "leave it out for the light nearest to the point".to_string(),
        };
        reader.wrong(format!("the net has no traffic light `{name}`"), fix);
        return None;
    }
    let point = point?;
    let distance = |l: &sumo_network::network::TrafficLight| (l.position - point).norm();
    let nearest = network.traffic_lights.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
    match nearest {
        Some(light) if distance(light) <= NEAR_LIGHT + light.radius => Some(light.id.clone()),
        found => {
            let how_far = found.map_or("the net has none".to_string(), |l| {
                format!("the nearest, `{}`, is {:.0} m away", l.id, distance(l))
            });
            reader.wrong(
                format!("no traffic light is near ({how_far})"),
                format!("move it to within {NEAR_LIGHT} m of one, or name it with wad.signal"),
            );
            None
        }
    }
}

/// Spacing of the samples of a polygon along a lane (m).
const STEP: f64 = 0.5;

fn read_polygon(reader: &mut Reader<'_>, network: &Network) -> Option<Thing> {
    reader.only(&[]);
    let Some(polygon) = shape(reader.element, network).1.filter(|p| p.shape.len() > 2) else {
        reader.wrong(
            "its area is not in the net's coordinates",
            "draw it again with three corners or more, without longitude and latitude",
        );
        return None;
    };
    let corners = &polygon.shape;
    let centre = Point::from(corners.iter().map(|p| p.coords).sum::<Vector>() / corners.len() as f64);
    let radius = corners.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max);
    let mut closures: Vec<Closure> = Vec::new();
    for near in roads(network, centre, radius + 4.0) {
        let shape = &network.lane(near.lane).shape;
        let inside = |s: f64| polygon_contains(corners, shape.at(s).xy());
        let steps = (shape.length() / STEP) as usize;
        let mut covered = (0..=steps).map(|i| i as f64 * STEP).filter(|&s| inside(s));
        if let Some(first) = covered.next() {
            let last = covered.next_back().unwrap_or(first);
            let at = LanePosition { lane: near.lane, s: first };
            closures.push(Closure { at, length: (last - first).max(STEP) });
        }
    }
    let Some(first) = closures.first().copied() else {
        reader.wrong(
            "it covers the middle of no lane that cars may use",
            "draw it over the lanes that the road works close",
        );
        return None;
    };
    Some(Thing {
        id: reader.element.id().to_string(),
        point: centre,
        lane: first.at.lane,
        s: first.at.s,
        d: 0.0,
        pose: network.lane(first.at.lane).shape.at(first.at.s),
        kind: Kind::RoadWorks(closures),
    })
}
