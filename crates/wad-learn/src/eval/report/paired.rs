//! Each driver that looks beside the autopilot on the same routes in the same traffic: what the one finishes and the other does
//! not, and who loses less time.

use super::table::columns;
use super::{Section, Table};
use crate::driver::DriverSpec;
use crate::eval::store::key;
use crate::eval::{Case, EpisodeRecord};
use std::collections::HashMap;
use wad_camera::Preset;
use wad_sim::tasks::TaskSpec;

/// A driver's episodes beside the autopilot's of the same routes.
#[derive(Debug, Default, PartialEq)]
struct Pairs {
    both: usize,
    alone: usize,
    autopilot_alone: usize,
    neither: usize,
    /// Of `both`, those in which the driver needs less time for its way.
    quicker: usize,
    /// Time for a way, over all of `both`, as a share of the autopilot's; None where nobody has moved.
    time: Option<f64>,
}

impl Pairs {
    fn of(pairs: &[(&EpisodeRecord, &EpisodeRecord)]) -> Self {
        let mut found = Self::default();
        // Way (m) and time (s) of the driver and of the autopilot: who survives has driven another way in the same time.
        let mut sums = [[0.0; 2]; 2];
        for (driver, autopilot) in pairs {
            let count = match (driver.ending.success, autopilot.ending.success) {
                (true, true) => &mut found.both,
                (true, false) => &mut found.alone,
                (false, true) => &mut found.autopilot_alone,
                (false, false) => &mut found.neither,
            };
            *count += 1;
            if driver.ending.success && autopilot.ending.success {
                let one = [driver, autopilot].map(|e| [e.distance_m, e.ticks as f64 * e.tick_s]);
                found.quicker += usize::from(one[0][1] * one[1][0] < one[1][1] * one[0][0]);
                sums.iter_mut().flatten().zip(one.iter().flatten()).for_each(|(sum, x)| *sum += x);
            }
        }
        let [own, autopilot] = sums.map(|[way, time]| (way > 0.0).then(|| time / way));
        found.time = own.zip(autopilot).map(|(own, autopilot)| own / autopilot);
        found
    }
}

/// What the blind drive alike: a case without its driver, its weather and the condition that follows from that.
pub(super) fn route(case: &Case) -> String {
    let spec = TaskSpec { weather: Preset::ClearNoon, ..case.spec.clone() };
    key(&Case { agent: DriverSpec::Autopilot, condition: String::new(), spec, ..case.clone() })
}

/// The table; None where the autopilot did not drive, or nobody who looks on its routes.
pub(super) fn beside_autopilot(section: &Section) -> Option<Table> {
    let all = section.episodes.iter().map(|e| &e.record);
    let autopilot = all.filter(|e| e.case.agent == DriverSpec::Autopilot);
    let autopilot: HashMap<String, &EpisodeRecord> = autopilot.map(|e| (route(&e.case), e)).collect();
    let row = |(mut cells, group): (Vec<String>, Vec<&EpisodeRecord>)| {
        let own = group.into_iter().filter(|e| e.case.agent.looks());
        let pairs: Vec<_> = own.filter_map(|e| Some((e, *autopilot.get(&route(&e.case))?))).collect();
        let found = Pairs::of(&pairs);
        cells.extend([pairs.len(), found.both, found.alone, found.autopilot_alone].map(|n| n.to_string()));
        cells.push(found.time.map_or("-".to_string(), |share| format!("{:+.1} %", 100.0 * (share - 1.0))));
        cells.push(format!("{} of {}", found.quicker, found.both));
        (!pairs.is_empty()).then_some(cells)
    };
    let rows: Vec<Vec<String>> = section.lines().into_iter().filter_map(row).collect();
    (!rows.is_empty()).then(|| Table {
        title: format!("{}: beside the autopilot on the same routes", section.suite.title),
        head: columns(&["routes", "both succeed", "only it", "only the autopilot", "time", "quicker"]),
        rows,
        notes: vec![
            "The same routes and traffic; the autopilot drives the same in every weather. Time for each kilometre where \
             both succeed, against the autopilot's: below 0 is time saved; and in how many of these it needs less."
                .to_string(),
        ],
        ..Table::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{End, Ending};
    use crate::eval::{Selection, Suite};

    #[test]
    fn who_saves_time_is_told_where_both_succeed() {
        let selection =
            Selection { agents: vec![DriverSpec::Random], episodes: Some(1), ..Selection::default() };
        let suite = Suite::find("nocrash").unwrap();
        let cases = selection.cases(&suite).unwrap();
        let episode = |way: f64, ticks: u64, success: bool| EpisodeRecord {
            distance_m: way,
            ticks,
            ending: Ending { end: End::Arrival, cause: String::new(), success },
            ..EpisodeRecord::of_a_tick(cases[0].0.clone())
        };
        let (quick, slow, lost) =
            (episode(100.0, 90, true), episode(100.0, 100, true), episode(5.0, 9, false));
        let found =
            Pairs::of(&[(&quick, &slow), (&slow, &slow), (&lost, &slow), (&slow, &lost), (&lost, &lost)]);
        let expected =
            Pairs { both: 2, alone: 1, autopilot_alone: 1, neither: 1, quicker: 1, time: Some(0.95) };
        assert!((found.time.unwrap() - 0.95).abs() < 1e-12, "{found:?}");
        assert_eq!(Pairs { time: expected.time, ..found }, expected);
        assert_eq!(Pairs::of(&[(&lost, &slow)]).time, None);
    }
}
