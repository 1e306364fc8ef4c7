//! Line charts as SVG, without a library.

use std::fmt::Write;

/// A chart: lines over a common x axis.
pub struct Chart {
    pub title: String,
    pub x: String,
    pub y: String,
    pub lines: Vec<Line>,
}

/// A line and what it is called; points that are not finite leave a gap.
pub struct Line {
    pub name: String,
    pub points: Vec<(f64, f64)>,
}

impl Line {
    /// `f` over `n` evenly spaced points.
    pub fn of(name: &str, (from, to): (f64, f64), n: usize, f: impl Fn(f64) -> f64) -> Self {
        let at = |i: usize| from + (to - from) * i as f64 / (n.max(2) - 1) as f64;
        Self { name: name.to_string(), points: (0..n.max(2)).map(|i| (at(i), f(at(i)))).collect() }
    }
}

const WIDTH: f64 = 560.0;
const PLOT_HEIGHT: f64 = 260.0;
const LEFT: f64 = 62.0;
const TOP: f64 = 34.0;
const RIGHT: f64 = 24.0;
const BOTTOM: f64 = 46.0;
const LEGEND_ROW: f64 = 17.0;
/// Colours that are told apart by those who see red and green alike (Okabe and Ito).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

impl Chart {
    /// The chart as an SVG document.
    pub fn svg(&self) -> String {
        let all =
            || self.lines.iter().flat_map(|line| &line.points).filter(|p| p.0.is_finite() && p.1.is_finite());
        let (x, y) = (Axis::around(all().map(|p| p.0), false), Axis::around(all().map(|p| p.1), true));
        let (plot_width, legend) = (WIDTH - LEFT - RIGHT, self.lines.len() as f64 * LEGEND_ROW);
        let height = TOP + PLOT_HEIGHT + BOTTOM + legend;
        let px = |v: f64| LEFT + x.share(v) * plot_width;
        let py = |v: f64| TOP + (1.0 - y.share(v)) * PLOT_HEIGHT;
        let mut s = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
             viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        );
        let mut text = |x: f64, y: f64, anchor: &str, more: &str, words: &str| {
            let words = words.replace('&', "&amp;").replace('<', "&lt;");
            // Writing to a String cannot fail.
            let _ =
                writeln!(s, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {more}>{words}</text>");
        };
        text(14.0, 20.0, "start", "font-size=\"14\" font-weight=\"bold\"", &self.title);
        let foot = TOP + PLOT_HEIGHT;
        text(LEFT + 0.5 * plot_width, foot + 36.0, "middle", "", &self.x);
        let middle = TOP + 0.5 * PLOT_HEIGHT;
        text(14.0, middle, "middle", &format!("transform=\"rotate(-90 14 {middle})\""), &self.y);
        for tick in x.ticks() {
            text(px(tick), foot + 17.0, "middle", "", &x.label(tick));
        }
        for tick in y.ticks() {
            text(LEFT - 6.0, py(tick) + 4.0, "end", "", &y.label(tick));
        }
        for (i, line) in self.lines.iter().enumerate() {
            let at = foot + BOTTOM + 10.0 + i as f64 * LEGEND_ROW;
            text(LEFT + 28.0, at, "start", "", &line.name);
        }
        let rule = |s: &mut String, x1: f64, y1: f64, x2: f64, y2: f64, colour: &str, width: f64| {
            let _ = writeln!(
                s,
                "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\" \
                 stroke-width=\"{width}\"/>"
            );
        };
        for tick in x.ticks() {
            rule(&mut s, px(tick), TOP, px(tick), foot, "#e4e4e4", 1.0);
        }
        for tick in y.ticks() {
            let colour = if tick.abs() < 1e-9 { "#888888" } else { "#e4e4e4" };
            rule(&mut s, LEFT, py(tick), WIDTH - RIGHT, py(tick), colour, 1.0);
        }
        for (i, line) in self.lines.iter().enumerate() {
            let colour = COLOURS[i % COLOURS.len()];
            let at = foot + BOTTOM + 6.0 + i as f64 * LEGEND_ROW;
            rule(&mut s, LEFT, at, LEFT + 22.0, at, colour, 3.0);
            for run in line.points.split(|p| !p.0.is_finite() || !p.1.is_finite()) {
                let points: Vec<String> =
                    run.iter().map(|p| format!("{:.1},{:.1}", px(p.0), py(p.1))).collect();
                let _ = writeln!(
                    s,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
                    points.join(" ")
                );
            }
        }
        s.push_str("</svg>\n");
        s
    }
}

/// A range with round ticks.
struct Axis {
    low: f64,
    high: f64,
    step: f64,
}

impl Axis {
    /// Around all values; with `room` a little more than that.
    fn around(values: impl Iterator<Item = f64>, room: bool) -> Self {
        let (mut low, mut high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if high - low < 1e-9 {
            (low, high) = (low.min(0.0), high.max(0.0) + 0.01);
        }
        if room {
            let more = 0.05 * (high - low);
            (low, high) = (low - more, high + more);
        }
        let rough = (high - low) / 6.0;
        let power = 10.0_f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|step| *step >= rough);
        Self { low, high, step: step.unwrap_or(10.0 * power) }
    }

    fn share(&self, v: f64) -> f64 {
        (v - self.low) / (self.high - self.low)
    }

    fn ticks(&self) -> impl Iterator<Item = f64> + use<> {
        let (first, last) = ((self.low / self.step).ceil() as i64, (self.high / self.step).floor() as i64);
        let step = self.step;
        (first..=last).map(move |k| k as f64 * step)
    }

    fn label(&self, tick: f64) -> String {
        let digits = (-self.step.log10().floor()).max(0.0) as usize;
        format!("{tick:.digits$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        let axis = Axis::around([0.0, 13.9].into_iter(), false);
        assert_eq!(axis.ticks().collect::<Vec<_>>(), [0.0, 5.0, 10.0]);
        assert_eq!(axis.label(5.0), "5");
        let axis = Axis::around([-0.31, 0.42].into_iter(), false);
        assert!(axis.ticks().all(|t| (-0.31..=0.42).contains(&t)) && axis.ticks().count() >= 3);
        assert_eq!(axis.label(0.2), "0.2");
    }

    #[test]
    fn a_chart_draws_every_line_and_breaks_it_at_gaps() {
        let gap = |x: f64| if x > 4.0 && x < 6.0 { f64::NAN } else { x };
        let chart = Chart {
            title: "a < b".into(),
            x: "x".into(),
            y: "y".into(),
            lines: vec![Line::of("one", (0.0, 10.0), 11, gap), Line::of("flat", (0.0, 10.0), 2, |_| 0.0)],
        };
        let svg = chart.svg();
        assert_eq!(svg.matches("<polyline").count(), 3);
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"), "{svg}");
    }
}
