//! The ego of a scenario: a trip or vehicle of type `ego`, and what its parameters say.

use super::params::{EGO, Reader};
use super::problem::Problem;
use super::xml::Element;
use crate::bridge::EGO_TYPE;
use crate::destination::EGO_CLASS;
use crate::suggest::{meant, near};
use crate::tasks::{Placement, Spot, TaskKind};
use crate::traffic::TrafficSpec;
use sumo_network::network::{EdgeKind, LaneId, LanePosition, Network, Route};
use wad_camera::Preset;
use wad_vehicle::EgoParams;

/// The ego's element, read.
#[derive(Clone, Debug)]
pub struct EgoPlan {
    pub kind: TaskKind,
    pub placement: Placement,
    pub route: Route,
    pub weather: Preset,
    pub traffic: TrafficSpec,
    /// s.
    pub time_limit: Option<f64>,
}

/// Room (m) that a start without a position leaves behind the car, and a destination without one before the
/// lane's end.
const START_ROOM: f64 = 1.0;
const END_ROOM: f64 = 10.0;
/// Way (m) that a scenario needs at the least.
const SHORTEST: f64 = 20.0;

/// Whether an element is an ego.
pub fn is_ego(element: &Element) -> bool {
    element.get("type") == Some(EGO_TYPE) && !matches!(element.tag.as_str(), "poi" | "poly")
}

/// The one ego among the elements.
pub fn find<'a>(
    elements: &'a [Element],
    config: &std::path::Path,
    problems: &mut Vec<Problem>,
) -> Option<&'a Element> {
    let egos: Vec<&Element> = elements.iter().filter(|element| is_ego(element)).collect();
    for more in egos.iter().skip(1) {
        let what = format!("a second ego: `{}` in line {} is one already", egos[0].id(), egos[0].line);
        problems.push(more.problem(what, "give it another type, or delete it"));
    }
    let Some(ego) = egos.first() else {
        // A file that cannot be read may have it.
        if !problems.is_empty() {
            return None;
        }
        problems.push(Problem::of_file(
            config,
            "no ego: none of its route files has a trip or vehicle of type `ego`",
            "in netedit's demand mode make a vehicle type `ego`, and a trip with it from start to destination",
        ));
        return None;
    };
    if !matches!(ego.tag.as_str(), "trip" | "vehicle") {
        let what = format!("the ego is a {}", ego.tag);
        problems.push(ego.problem(what, "make it a trip (from edge, to edge) or a vehicle with a route"));
        return None;
    }
    if !elements.iter().any(|e| e.tag == "vType" && e.id() == EGO_TYPE) {
        problems.push(ego.problem(
            "its type `ego` is not defined, and netedit drops vehicles whose type it does not know",
            "add <vType id=\"ego\"/> to the same route file",
        ));
    }
    Some(ego)
}

/// Reads the ego; None if it cannot be driven, with the reason in `problems`.
pub fn read(
    element: &Element,
    elements: &[Element],
    network: &Network,
    problems: &mut Vec<Problem>,
) -> Option<EgoPlan> {
    let mut reader = Reader { element, problems };
    reader.only(EGO);
    let kind = match element.param("wad.task").map(|text| (text, text.parse::<TaskKind>())) {
        None => TaskKind::Navigation,
        Some((_, Ok(kind))) => kind,
        Some((text, Err(_))) => {
            let names: Vec<&str> = TaskKind::ALL.iter().map(|kind| kind.name()).collect();
            reader.wrong(format!("`wad.task` is `{text}`"), meant(text, &names));
            TaskKind::Navigation
        }
    };
    let weather = match element.param("wad.weather").map(|text| (text, text.parse::<Preset>())) {
        None => Preset::default(),
        Some((_, Ok(weather))) => weather,
        Some((text, Err(_))) => {
            let names: Vec<&str> = Preset::ALL.iter().map(|preset| preset.name()).collect();
            reader.wrong(format!("`wad.weather` is `{text}`"), meant(text, &names));
            Preset::default()
        }
    };
    let traffic = match element.param("wad.traffic").map(str::parse::<TrafficSpec>) {
        None => kind.traffic(),
        Some(Ok(traffic)) => traffic,
        Some(Err(error)) => {
            reader.wrong(
                format!("`wad.traffic` is `{}`", error.found),
                "expected empty, regular, dense, or VEHICLES,PEDESTRIANS such as 30,50",
            );
            kind.traffic()
        }
    };
    let time_limit = reader.optional("wad.time_limit", 1.0, 36_000.0, "seconds");
    let ends = Ends { network, elements };
    let start = ends.start(&mut reader);
    // All three before the first `?`, so that one mistake does not hide another.
    let (to, via) = (ends.destination(&mut reader), ends.via(&mut reader));
    let (start, to, via) = (start?, to?, via?);
    let (route, via) = ends.route(&mut reader, start, &via, to)?;
    if route.length() < SHORTEST {
        let what = format!("its way is only {:.0} m long", route.length());
        reader.wrong(what, format!("move the destination on: {SHORTEST} m are the least"));
        return None;
    }
    let spot = |at: LanePosition| Spot::at(network, at);
    let placement = Placement {
        from: spot(start),
        to: spot(route.to),
        via: via.into_iter().map(spot).collect(),
        obstacle: None,
    };
    Some(EgoPlan { kind, placement, route, weather, traffic, time_limit })
}

/// Lanes of a place that may be any of them, each with its arc length (m); one at the least.
type Places = Vec<LanePosition>;

struct Ends<'a> {
    network: &'a Network,
    elements: &'a [Element],
}

impl Ends<'_> {
    /// Lanes of an edge that the ego may drive on, outermost first.
    fn open(&self, reader: &mut Reader<'_>, what: &str, name: &str) -> Option<Vec<LaneId>> {
        let network = self.network;
        let open = |lane: &LaneId| network.lane(*lane).permissions.allows(EGO_CLASS);
        let lanes: Vec<LaneId> = match (network.lane_by_id(name), network.edge_by_id(name)) {
            (Some(lane), _) => vec![lane],
            (_, Some(edge)) => network.edge(edge).lanes.clone(),
            _ => {
                let names =
                    network.edges.iter().filter(|e| e.kind == EdgeKind::Normal).map(|e| e.id.as_str());
                let close = near(name, names);
                let fix = if close.is_empty() {
                    "click the edge in netedit to see its id".to_string()
                } else {
                    format!("did you mean {}?", close.join(" or "))
                };
                reader.wrong(format!("{what} `{name}` is neither an edge nor a lane of the net"), fix);
                return None;
            }
        };
        let open: Vec<LaneId> = lanes.into_iter().filter(open).collect();
        if open.is_empty() {
            reader.wrong(
                format!("cars may not drive on {what} `{name}`"),
                "choose an edge or lane that is open to passenger cars",
            );
            return None;
        }
        Some(open)
    }

    /// All edges of a route that is given edge by edge.
    fn edges(&self, element: &Element) -> Option<Vec<String>> {
        let own = element.route.clone();
        let named = || {
            let id = element.get("route")?;
            let route = self.elements.iter().find(|e| e.tag == "route" && e.id() == id)?;
            route.get("edges").map(String::from)
        };
        let edges = own.or_else(named)?;
        Some(edges.split_whitespace().map(String::from).collect())
    }

    fn start(&self, reader: &mut Reader<'_>) -> Option<LanePosition> {
        let element = reader.element;
        let edges = self.edges(element);
        let from = match (&edges, element.get("from")) {
            (Some(edges), _) if !edges.is_empty() => edges[0].clone(),
            (_, Some(from)) => from.to_string(),
            _ => {
                reader.wrong("it has no edge to start from", "draw it as a trip from edge to edge");
                return None;
            }
        };
        let lanes = self.open(reader, "its first edge", &from)?;
        let lane = match element.get("departLane") {
            None | Some("first" | "best" | "allowed" | "free") => Some(lanes[0]),
            Some(text) => self.named_lane(reader, "departLane", text, &from, &lanes),
        };
        let half = 0.5 * EgoParams::default().length;
        let length = self.network.lane(lane.unwrap_or(lanes[0])).length;
        // SUMO counts to the front bumper.
        let front = match element.get("departPos") {
            None | Some("base" | "free") => Some(2.0 * half + START_ROOM),
            Some(text) => self.position(reader, "departPos", text, length),
        };
        let (lane, front) = (lane?, front?);
        let lane_ = self.network.lane(lane);
        let s = lane_.arc_length(front.max(2.0 * half)) - half;
        Some(LanePosition { lane, s: s.clamp(0.0, lane_.shape.length()) })
    }

    /// The one of an edge's open `lanes` with index `text`.
    fn named_lane(
        &self,
        reader: &mut Reader<'_>,
        name: &str,
        text: &str,
        edge: &str,
        lanes: &[LaneId],
    ) -> Option<LaneId> {
        let index = |lane: &LaneId| self.network.lane(*lane).index;
        let wanted = text.parse::<usize>().ok();
        let found = lanes.iter().copied().find(|lane| Some(index(lane)) == wanted);
        if found.is_none() {
            let open: Vec<String> = lanes.iter().map(|lane| index(lane).to_string()).collect();
            let fix = format!("cars may use lane {} of `{edge}`", open.join(" or "));
            reader.wrong(format!("{name} is `{text}`"), fix);
        }
        found
    }

    /// A position on a lane (m), from its end where it is negative.
    fn position(&self, reader: &mut Reader<'_>, name: &str, text: &str, length: f64) -> Option<f64> {
        let value = text.parse::<f64>().ok().map(|v| if v < 0.0 { length + v } else { v });
        let found = value.filter(|v| (0.0..=length + 0.01).contains(v));
        if found.is_none() {
            let fix = format!("expected metres from 0 to the lane's {length:.2}");
            reader.wrong(format!("{name} is `{text}`"), fix);
        }
        found.map(|v| v.min(length))
    }

    /// `EDGE`, `LANE`, or either with `@POSITION`.
    fn place(
        &self,
        reader: &mut Reader<'_>,
        what: &str,
        text: &str,
        default: impl Fn(f64) -> f64,
    ) -> Option<Places> {
        let (name, position) = match text.rsplit_once('@') {
            Some((name, position)) => (name, Some(position)),
            None => (text, None),
        };
        let lanes = self.open(reader, what, name)?;
        let length = self.network.lane(lanes[0]).length;
        let position = match position {
            Some(position) => self.position(reader, &format!("the position of {what}"), position, length)?,
            None => default(length),
        };
        let at = |lane: LaneId| {
            let l = self.network.lane(lane);
            LanePosition { lane, s: l.arc_length(position.min(l.length)) }
        };
        Some(lanes.into_iter().map(at).collect())
    }

    /// The end of the trip or route as drawn. `wad.destination` counts where nothing is drawn, and adds lane and
    /// position where it names the drawn edge: netedit moves the one and does not know the other.
    fn destination(&self, reader: &mut Reader<'_>) -> Option<Places> {
        let element = reader.element;
        let late = |length: f64| (length - END_ROOM).max(0.5 * length);
        let edges = self.edges(element);
        let to = edges.as_ref().and_then(|edges| edges.last()).map(String::as_str).or(element.get("to"));
        let parameter = element.param("wad.destination");
        let named = parameter.map(|text| (text, self.place(reader, "`wad.destination`", text, late)));
        let Some(to) = to else {
            if named.is_none() {
                reader.wrong(
                    "it has no destination",
                    "draw it as a trip to an edge, or add the parameter wad.destination with an edge or lane",
                );
            }
            return named?.1;
        };
        let lanes = self.open(reader, "its last edge", to);
        let named = match named {
            Some((text, places)) => Some((text, places?)),
            None => None,
        };
        let lanes = lanes?;
        let edge = |lane: LaneId| self.network.lane(lane).edge;
        let mut places: Places = match named {
            Some((_, places)) if edge(places[0].lane) == edge(lanes[0]) => places,
            named => {
                if let Some((text, _)) = named {
                    tracing::warn!(
                        "{}:{}: the drawn destination `{to}` counts, not wad.destination `{text}`; remove it",
                        element.file.display(),
                        element.line
                    );
                }
                let at = |lane: LaneId| {
                    let l = self.network.lane(lane);
                    LanePosition { lane, s: l.arc_length(late(l.length)) }
                };
                lanes.iter().copied().map(at).collect()
            }
        };
        let lane = match element.get("arrivalLane").filter(|text| !matches!(*text, "current" | "first")) {
            None => Some(None),
            Some(text) => self.named_lane(reader, "arrivalLane", text, to, &lanes).map(Some),
        };
        let length = self.network.lane(lane.flatten().unwrap_or(places[0].lane)).length;
        let position = match element.get("arrivalPos").filter(|text| *text != "max") {
            None => Some(None),
            Some(text) => self.position(reader, "arrivalPos", text, length).map(Some),
        };
        let (lane, position) = (lane?, position?);
        if let Some(lane) = lane {
            let s = self.network.lane(lane).arc_length(late(length));
            places = vec![places.into_iter().find(|p| p.lane == lane).unwrap_or(LanePosition { lane, s })];
        }
        if let Some(position) = position {
            for place in &mut places {
                place.s = self.network.lane(place.lane).arc_length(position);
            }
        }
        Some(places)
    }

    fn via(&self, reader: &mut Reader<'_>) -> Option<Vec<Places>> {
        let element = reader.element;
        let middle = |length: f64| 0.5 * length;
        let mut names: Vec<(&str, String)> = Vec::new();
        match (element.param("wad.via"), self.edges(element)) {
            (Some(text), _) => names.extend(text.split_whitespace().map(|n| ("`wad.via`", n.to_string()))),
            (None, Some(edges)) if edges.len() > 2 => {
                names.extend(edges[1..edges.len() - 1].iter().map(|n| ("its route's edge", n.clone())));
            }
            _ => {
                let via = element.get("via").unwrap_or_default();
                names.extend(via.split_whitespace().map(|n| ("via", n.to_string())));
            }
        }
        let places: Vec<_> =
            names.iter().map(|(what, name)| self.place(reader, what, name, middle)).collect();
        places.into_iter().collect()
    }

    /// The shortest way, and the via points as they came to lie on lanes.
    fn route(
        &self,
        reader: &mut Reader<'_>,
        start: LanePosition,
        via: &[Places],
        to: Places,
    ) -> Option<(Route, Vec<LanePosition>)> {
        let network = self.network;
        let mut route: Option<Route> = None;
        let mut passed = Vec::with_capacity(via.len());
        let stages = via.iter().chain(std::iter::once(&to));
        for (number, places) in stages.enumerate() {
            let mut best: Option<Route> = None;
            let mut why = String::new();
            for place in places {
                let longer = match &route {
                    None => network.route(start, *place, EGO_CLASS),
                    Some(so_far) => {
                        let mut longer = so_far.clone();
                        network.extend_route(&mut longer, *place).map(|()| longer)
                    }
                };
                match longer {
                    Ok(longer) if best.as_ref().is_none_or(|b| longer.length() < b.length() - 0.5) => {
                        best = Some(longer);
                    }
                    Ok(_) => {}
                    Err(error) => why = error.to_string(),
                }
            }
            let Some(best) = best else {
                let last = number == via.len();
                let what = if last {
                    "its destination cannot be reached".to_string()
                } else {
                    format!("via point {} cannot be reached", number + 1)
                };
                reader.wrong(format!("{what}: {why}"), "choose a place that cars can get to from there");
                return None;
            };
            passed.push(best.to);
            route = Some(best);
        }
        passed.pop();
        Some((route?, passed))
    }
}
