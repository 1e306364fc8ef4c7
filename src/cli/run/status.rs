//! The status line of `run`: drive and detections, tick by tick.

use indicatif::{ProgressBar, ProgressStyle};
use std::time::{Duration, Instant};
use wad_cosim::criteria::Event;
use wad_cosim::drive::Status;
use wad_cosim::perception::Percept;

/// One line that changes in place on a terminal; a plain line now and then elsewhere.
pub(super) struct StatusLine {
    bar: Option<ProgressBar>,
    last: Option<Instant>,
}

impl StatusLine {
    pub fn new(plain: bool, limit: Option<u64>) -> Self {
        let bar = (!plain).then(|| {
            let bar = limit.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
            let template = if limit.is_some() {
                "{bar:20} {pos}/{len}, {eta} left  {msg}"
            } else {
                "{spinner} {pos}  {msg}"
            };
            ProgressStyle::with_template(template).map_or(bar.clone(), |style| bar.with_style(style))
        });
        Self { bar, last: None }
    }

    pub fn show(&mut self, status: &Status, percept: Option<&Percept>) {
        let every = if self.bar.is_some() { Duration::from_millis(100) } else { Duration::from_secs(5) };
        for event in &status.record.events {
            self.say(&format!("{:8.1} s  {}", status.record.time, describe(event)));
        }
        if self.last.is_some_and(|last| last.elapsed() < every) {
            return;
        }
        self.last = Some(Instant::now());
        let text = describe_tick(status) + &percept.map_or(String::new(), describe_percept);
        match &self.bar {
            Some(bar) => {
                bar.set_position(status.record.tick);
                bar.set_message(text);
            }
            None => crate::cli::note(text),
        }
    }

    pub fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| crate::cli::note(text)),
            None => crate::cli::note(text),
        }
    }

    pub fn clear(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn describe_tick(status: &Status) -> String {
    let r = &status.record;
    let light = r.light.map_or("-".to_string(), |l| format!("{} {:.0} m", serde_name(&l.state), l.distance));
    let leader = r.leader.map_or("-".to_string(), |l| format!("{:.0} m", l.gap));
    format!(
        "{:7.1} s  {:5.1} km/h (limit {:.0})  light {light}  leader {leader}  route {:3.0} %  {}  {:.0} ticks/s",
        r.time,
        tenths(r.ego.speed * 3.6),
        r.limit * 3.6,
        100.0 * r.route.s / r.route.length.max(1e-9),
        r.reason.map_or(String::new(), |reason| reason_name(&reason)),
        status.ticks_per_second,
    )
}

/// Rounded to a tenth, and never -0.0: a car that stands may roll back by a hair.
fn tenths(x: f64) -> f64 {
    (10.0 * x).round() / 10.0 + 0.0
}

fn describe_percept(percept: &Percept) -> String {
    let side = |line: Option<_>, letter| if line.is_some() { letter } else { '-' };
    let lead = percept.raw.lead.map_or("-".to_string(), |l| format!("{:.0} m", l.gap));
    format!(
        "  sees {} objects, lanes {}{}, ahead {lead}{}",
        percept.detections.len(),
        side(percept.lanes.left, 'L'),
        side(percept.lanes.right, 'R'),
        if percept.light_red { ", red light here" } else { "" },
    )
}

fn describe(event: &Event) -> String {
    match event {
        Event::Collision { kind, partner, impulse, cause, reason, .. } => format!(
            "collision with {} {partner}, {impulse:.0} N s, caused by {}: {reason}",
            serde_name(kind),
            serde_name(cause)
        ),
        Event::RedLight { traffic_light, speed } => {
            format!("ran the red light {traffic_light} at {speed:.1} m/s")
        }
        Event::OutsideLane { offset } => format!("outside the lane by {offset:.2} m"),
        Event::Sidewalk => "a wheel left the road".to_string(),
        Event::VehicleBlocked => "blocked without a reason".to_string(),
        Event::Arrival => "arrived".to_string(),
    }
}

fn reason_name(reason: &wad_cosim::autopilot::Reason) -> String {
    let value = serde_json::to_value(reason).unwrap_or_default();
    value.get("kind").and_then(|kind| kind.as_str()).unwrap_or_default().replace('_', " ")
}

fn serde_name(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default().trim_matches('"').replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standing_car_has_no_negative_speed() {
        assert_eq!(format!("{:.1}", tenths(-0.004)), "0.0");
        assert_eq!(format!("{:.1} {:.1}", tenths(-0.06), tenths(49.97)), "-0.1 50.0");
    }
}
