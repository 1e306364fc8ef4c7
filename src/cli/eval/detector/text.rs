//! What `eval detector` and `eval eyes` print.

use super::{Report, Scores};
use std::fmt::Write as _;
use wad_cosim::perception::score::{BELIEVED, BySureness, FALSE_ALARM_GOAL, GROUPS, Precision};
use wad_cosim::perception::sight_score::RoadReport;

/// The rows of lane and light.
fn road_text(rows: &[(String, RoadReport)]) -> String {
    let mut out = String::from(
        "\nThe ego's lane, 0.5 m at 10 m, and its light within 40 m; the stop line's distance within 20 m\n\
         | weather | boundaries found | median m | lanes seen in junctions | lights right | missed | red called green | seen where none is | stop line, median m | signs found | signs read within 12 m | signs seen where none is | road, IoU |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let share = |v: Option<f64>, of: usize| v.map_or("-".to_string(), |v| format!("{v:.3} of {of}"));
    let metres = |v: Option<f64>| v.map_or("-".to_string(), |v| format!("{v:.2}"));
    for (weather, r) in rows {
        let _ = writeln!(
            out,
            "| {weather} | {} | {} | {} | {} | {} | {} of {} | {} | {} | {} | {} | {} | {} |",
            share(r.boundaries_found, r.boundaries),
            metres(r.lateral_error.median),
            share(r.phantom_lanes, r.junctions),
            share(r.lights_right, r.lights),
            share(r.lights_missed, r.lights),
            r.red_as_green,
            r.reds,
            share(r.phantom_lights, r.without_light),
            metres(r.line_error.median),
            share(r.signs_found, r.signs),
            share(r.signs_right, r.near_signs),
            share(r.phantom_signs, r.frames),
            r.area_iou.map_or("-".to_string(), |v| format!("{v:.3}")),
        );
    }
    out
}

/// The rows of what is found by height.
fn sureness_text(rows: &[BySureness]) -> String {
    let mut out = String::from(
        "Found (a box of its group overlaps by 0.4), and how many a frame are where nothing is, from a score on; agents \
         drive by 0.4 up to a height of 12 px, falling to 0.3 at 32 (of `onnx` by 0.3), and by what of it does not stand \
         on free road, which is not left out here\n",
    );
    let by_height = || "from 0.4 to 0.3 by height".to_string();
    let least = |least: Option<f32>| least.map_or_else(by_height, |s| format!("from {s:.1}"));
    let first = rows.first().map_or(&[][..], |row| &row.from);
    let columns: Vec<String> = first.iter().map(|one| least(one.least)).collect();
    let _ =
        writeln!(out, "| | truths | {} |\n|---|---{}|", columns.join(" | "), "|---".repeat(columns.len()));
    for row in rows {
        let cells = row.from.iter().map(|one| {
            let recall = one.recall.map_or("-".to_string(), |recall| format!("{:.1} %", 100.0 * recall));
            format!("{recall}; {:.2}", one.false_alarms_per_frame)
        });
        let cells: Vec<String> = cells.collect();
        let height = row.high.map_or_else(|| "px or more".to_string(), |high| format!("to {high} px"));
        let _ =
            writeln!(out, "| {}, {} {height} | {} | {} |", row.group, row.low, row.truths, cells.join(" | "));
    }
    out + "\n"
}

/// What all detectors see, side by side where there are several, and then each by weather and class.
pub fn of(report: &Report) -> String {
    let mut out = String::new();
    let are_several = report.detectors.len() > 1;
    if are_several {
        out += &side_by_side(report);
    }
    for scores in &report.detectors {
        if are_several {
            out += "\n";
        }
        let _ = writeln!(
            out,
            "{} on {} frames of {}, {:.1} ms a frame\n",
            scores.detector, report.frames, report.town, scores.detect_ms
        );
        out += &one(scores);
    }
    out
}

fn number(v: Option<f64>) -> String {
    v.map_or("-".to_string(), |v| format!("{v:.3}"))
}

/// A row for each figure, a column for each detector.
fn side_by_side(report: &Report) -> String {
    let mut out = format!("{} frames of {}\n\n", report.frames, report.town);
    let mut row = |name: &str, cell: &dyn Fn(&Scores) -> String| {
        let cells: Vec<String> = report.detectors.iter().map(cell).collect();
        let _ = writeln!(out, "| {name} | {} |", cells.join(" | "));
    };
    row("", &|s| s.detector.clone());
    row("---", &|_| "---".to_string());
    let all =
        |rows: &[Precision], figure: &dyn Fn(&Precision) -> Option<f64>| number(rows.last().and_then(figure));
    row("mAP@0.5, boxes 24 px high or more, training weathers", &|s| {
        all(&s.precision_training_weathers, &|p| p.ap50)
    });
    row("the same, unseen weathers", &|s| all(&s.precision_unseen_weathers, &|p| p.ap50));
    row("mAP@0.5, 12 to 24 px", &|s| all(&s.precision, &|p| p.ap50_small));
    row("AP@0.5, people 24 px high or more", &|s| {
        number(s.precision.iter().find(|p| p.class == "person").and_then(|p| p.ap50))
    });
    let weathers: Vec<&String> =
        report.detectors.iter().take(1).flat_map(|s| &s.road).map(|(weather, _)| weather).collect();
    if !weathers.is_empty() {
        for weather in weathers.iter().filter(|w| ["all", "ClearNoon", "HardRainNoon"].contains(&w.as_str()))
        {
            row(&format!("lane boundaries found (0.5 m at 10 m), {weather}"), &|s| {
                number(road(s, weather).and_then(|r| r.boundaries_found))
            });
        }
        let on_all = |figure: fn(&RoadReport) -> Option<String>| {
            move |s: &Scores| road(s, "all").and_then(figure).unwrap_or_else(|| "-".to_string())
        };
        // Of a detector that sees some; Canny and Hough see none.
        row(
            "the ego's light right, within 40 m",
            &on_all(|r| r.lights_right.filter(|_| sees_lights(r)).map(|v| format!("{v:.3} of {}", r.lights))),
        );
        row(
            "red called green",
            &on_all(|r| sees_lights(r).then(|| format!("{} of {}", r.red_as_green, r.reds))),
        );
        row(
            "stop line, median error within 20 m (m)",
            &on_all(|r| r.line_error.median.map(|v| format!("{v:.2}"))),
        );
        row(
            "signs read within 12 m",
            &on_all(|r| {
                let seen = r.signs_right.filter(|_| r.signs_found > Some(0.0));
                seen.map(|v| format!("{v:.3} of {}", r.near_signs))
            }),
        );
        row("what is road, IoU", &on_all(|r| r.area_iou.filter(|v| *v > 0.0).map(|v| format!("{v:.3}"))));
    }
    row("ms a frame, in turns with the others", &|s| format!("{:.1}", s.detect_ms));
    out
}

fn sees_lights(report: &RoadReport) -> bool {
    report.lights_missed < Some(1.0)
}

fn road<'a>(scores: &'a Scores, weather: &str) -> Option<&'a RoadReport> {
    scores.road.iter().find(|(name, _)| name == weather).map(|(_, report)| report)
}

/// One detector's tables.
fn one(report: &Scores) -> String {
    let mut out = format!("Recall at a score of {BELIEVED} (hits / truths), and false alarms per frame\n");
    let header: Vec<String> =
        GROUPS.iter().map(|g| format!("{} >= {} px", g.name, g.height)).chain(["false".into()]).collect();
    let _ = writeln!(out, "| weather | {} |\n|---{}|", header.join(" | "), "|---".repeat(header.len()));
    let all = ("all".to_string(), &report.realism);
    for (name, score) in report.realism_by_weather.iter().map(|(w, s)| (w.to_string(), s)).chain([all]) {
        let cells = GROUPS.iter().map(|g| {
            score.groups.get(g.name).map_or_else(String::new, |s| match s.recall {
                Some(recall) => format!("{recall:.2} ({}/{})", s.hits, s.truths),
                None => "-".to_string(),
            })
        });
        let cells: Vec<String> = cells.chain([format!("{:.2}", score.false_alarms_per_frame)]).collect();
        let _ = writeln!(out, "| {name} | {} |", cells.join(" | "));
    }
    let goals = GROUPS.iter().map(|g| g.goal.map_or("-".to_string(), |goal| format!("{goal:.2}")));
    let goals: Vec<String> = goals.chain([format!("< {FALSE_ALARM_GOAL:.0}")]).collect();
    let _ = writeln!(out, "| goal | {} |\n", goals.join(" | "));

    out += "By class, counted as found if detected as any class of its group:";
    for (n, (class, score)) in report.realism.classes.iter().enumerate() {
        let recall = score.hits as f64 / score.truths.max(1) as f64;
        let comma = if n == 0 { "" } else { "," };
        let _ = write!(out, "{comma} {class} {recall:.2} ({}/{})", score.hits, score.truths);
    }
    out += "\n\n";

    out += &sureness_text(&report.sureness);
    out += "Average precision of boxes 24 px high or more, and of 12 to 24 px\n";
    out += "| class | truths | AP@0.5 | training weathers | unseen weathers | AP@[.5:.95] | truths 12-24 | AP@0.5 12-24 |\n";
    out += "|---|---|---|---|---|---|---|---|\n";
    let counted = |rows: &[Precision], n: usize| match rows.get(n) {
        Some(row) if row.truths > 0 => format!("{} of {}", number(row.ap50), row.truths),
        _ => "-".to_string(),
    };
    for (n, row) in report.precision.iter().enumerate() {
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} | {} | {} |",
            row.class,
            row.truths,
            number(row.ap50),
            counted(&report.precision_training_weathers, n),
            counted(&report.precision_unseen_weathers, n),
            number(row.ap),
            row.truths_small,
            number(row.ap50_small)
        );
    }
    out += "\nmAP by weather\n| weather | mAP@0.5 | mAP@[.5:.95] | mAP@0.5 12-24 |\n|---|---|---|---|\n";
    let by_weather = report.precision_by_weather.iter().map(|(w, rows)| (w.to_string(), rows));
    let groups = [
        ("training weathers".to_string(), &report.precision_training_weathers),
        ("unseen weathers".to_string(), &report.precision_unseen_weathers),
    ];
    for (weather, rows) in by_weather.chain(groups) {
        if let Some(all) = rows.last() {
            let cells = [all.ap50, all.ap, all.ap50_small].map(number);
            let _ = writeln!(out, "| {weather} | {} |", cells.join(" | "));
        }
    }
    if !report.road.is_empty() {
        out += &road_text(&report.road);
    }
    out
}
