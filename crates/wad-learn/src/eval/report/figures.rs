//! A section's figures.

use super::Section;
use super::svg::{Svg, distribution, stacked};
use crate::env::{Assets, End};
use crate::eval::{Histogram, Score};
use sumo_network::network::{LinkId, Network};
use wad_sim::destination::EGO_CLASS;

/// Kinds of ends and their colours: good ones cool, bad ones warm.
const ENDS: [(&str, &str); 9] = [
    ("arrival", "#009e73"),
    ("survived", "#56b4e9"),
    ("collision", "#d55e00"),
    ("red light", "#cc79a7"),
    ("outside lane", "#e69f00"),
    ("sidewalk", "#b8860b"),
    ("vehicle blocked", "#f0e442"),
    ("timeout", "#999999"),
    ("error", "#444444"),
];

fn colour(end: End) -> &'static str {
    End::ALL.iter().position(|e| *e == end).map_or("#444444", |i| ENDS[i].1)
}

/// The paper's figure 8: how episodes ended.
pub fn ends(section: &Section) -> String {
    let mut rows = Vec::new();
    for condition in section.conditions() {
        for task in section.tasks() {
            for driver in &section.drivers {
                let group = section.by(driver, |e| e.condition == condition && e.task == task);
                if group.is_empty() {
                    continue;
                }
                let score = Score::of(&group);
                let counts = End::ALL.map(|end| score.ends.get(&end).copied().unwrap_or(0));
                rows.push((format!("{task}, {condition}, {driver}"), counts.to_vec()));
            }
        }
    }
    stacked(&ENDS, &rows)
}

/// Speeds, and gaps to the vehicle in front, by agent.
pub fn distributions(section: &Section) -> [String; 2] {
    let of = |pick: &dyn Fn(Score) -> Histogram| -> Vec<(String, Vec<u64>)> {
        let of = |driver| pick(Score::of(&section.by(driver, |_| true))).0;
        section.drivers.iter().map(|driver| (driver.to_string(), of(driver))).collect()
    };
    let (speeds, gaps) = (of(&|s| s.speeds), of(&|s| s.gaps));
    [
        distribution("Speed: share of all ticks", "km/h", Histogram::SPEED, &speeds),
        distribution("True gap to the vehicle in front: share of ticks with one", "m", Histogram::GAP, &gaps),
    ]
}

/// A map per town: its roads, and where episodes ended. None if the net is missing.
pub fn maps(section: &Section) -> Vec<(String, Option<String>)> {
    let mut towns: Vec<String> = Vec::new();
    for episode in &section.episodes {
        if !towns.contains(&episode.record.case.town) {
            towns.push(episode.record.case.town.clone());
        }
    }
    let map = |town: String| {
        let assets = Assets::load(&town);
        let drawn = assets.map(|assets| map(section, &town, assets.network()));
        if let Err(error) = &drawn {
            tracing::warn!("no map of {town}: {error}");
        }
        (town, drawn.ok())
    };
    towns.into_iter().map(map).collect()
}

/// Width of a map (pixels).
const MAP: f64 = 620.0;

fn map(section: &Section, town: &str, network: &Network) -> String {
    let points = |line: &sumo_network::geometry::Polyline| {
        let steps = (line.length() / 8.0).ceil().max(1.0) as usize;
        let at = |i: usize| line.at(line.length() * i as f64 / steps as f64).xy();
        (0..=steps).map(|i| (at(i).x, at(i).y)).collect::<Vec<_>>()
    };
    let open = |lane| network.lane(lane).permissions.allows(EGO_CLASS);
    let links = network.links.iter().enumerate().filter(|(_, link)| open(link.from) && open(link.to));
    let links = links.map(|(i, _)| points(&network.link_path(LinkId(i as u32))));
    let lanes = network.drivable_lanes(EGO_CLASS).iter().map(|&lane| points(&network.lane(lane).shape));
    let lanes: Vec<Vec<(f64, f64)>> = links.chain(lanes).collect();
    let all = || lanes.iter().flatten();
    let (left, right) = all().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.0), h.max(p.0)));
    let (low, high) = all().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.1), h.max(p.1)));
    let scale = (MAP - 20.0) / (right - left).max(high - low).max(1.0);
    let at = |x: f64, y: f64| (10.0 + (x - left) * scale, 10.0 + (high - y) * scale);
    let mut svg = Svg::new((right - left) * scale + 20.0, (high - low) * scale + 20.0);
    for lane in &lanes {
        svg.line(&lane.iter().map(|&(x, y)| at(x, y)).collect::<Vec<_>>(), "#c4c8cc", 2.0);
    }
    // Successes below, so that none hides a failure.
    for success in [true, false] {
        for entry in &section.episodes {
            let e = &entry.record;
            if e.case.town != town || e.ending.success != success {
                continue;
            }
            let words = format!("{}: {} ({}); {}", entry.driver, e.ending.end, e.ending.cause, e.case.name());
            let [x, y] = e.end_at;
            svg.dot(at(x, y), if success { 3.0 } else { 5.0 }, colour(e.ending.end), &words);
        }
    }
    svg.finish()
}

/// The colours of the maps' dots.
pub fn legend() -> String {
    let dot = |(name, colour): &(&str, &str)| {
        format!("<span class=\"key\"><i style=\"background:{colour}\"></i>{name}</span>")
    };
    ENDS.iter().map(dot).collect()
}
