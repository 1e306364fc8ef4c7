//! Figures as SVG.

use std::fmt::Write;

/// Colours that people with red-green blindness can distinguish (Okabe and Ito).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

/// A drawing.
pub struct Svg {
    width: f64,
    height: f64,
    body: String,
}

/// Text escaped for SVG and HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

impl Svg {
    /// An empty drawing (pixels).
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, body: String::new() }
    }

    /// Writing to a String cannot fail.
    fn push(&mut self, text: std::fmt::Arguments<'_>) {
        let _ = self.body.write_fmt(text);
        self.body.push('\n');
    }

    pub fn text(&mut self, x: f64, y: f64, anchor: &str, words: &str) {
        self.styled(x, y, anchor, "", words);
    }

    /// Text with more attributes.
    fn styled(&mut self, x: f64, y: f64, anchor: &str, more: &str, words: &str) {
        self.push(format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{more}>{}</text>",
            escape(words)
        ));
    }

    /// A straight line of an axis or a legend.
    fn rule(&mut self, (x1, y1): (f64, f64), (x2, y2): (f64, f64), colour: &str, width: f64) {
        self.push(format_args!(
            "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\" \
             stroke-width=\"{width}\"/>"
        ));
    }

    /// A filled rectangle with the tooltip `title`.
    pub fn bar(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), fill: &str, title: &str) {
        self.push(format_args!(
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{fill}\"><title>{}</title></rect>",
            escape(title)
        ));
    }

    pub fn line(&mut self, points: &[(f64, f64)], colour: &str, width: f64) {
        let points: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        self.push(format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>",
            points.join(" ")
        ));
    }

    /// A shaded area.
    fn area(&mut self, points: impl Iterator<Item = (f64, f64)>, colour: &str) {
        let points: Vec<String> = points.map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        self.push(format_args!(
            "<polygon points=\"{}\" fill=\"{colour}\" fill-opacity=\"0.15\"/>",
            points.join(" ")
        ));
    }

    pub fn dot(&mut self, (x, y): (f64, f64), radius: f64, fill: &str, title: &str) {
        self.push(format_args!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{fill}\" stroke=\"white\" stroke-width=\"0.7\"><title>{}</title></circle>",
            escape(title)
        ));
    }

    /// The drawing as an element for a page.
    pub fn finish(self) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w:.0} {h:.0}\" width=\"{w:.0}\" height=\"{h:.0}\" \
             font-family=\"sans-serif\" font-size=\"12\">\n{}</svg>\n",
            self.body,
            w = self.width,
            h = self.height
        )
    }
}

/// Stacked bars of shares: one row per name, one colour per kind.
pub fn stacked(kinds: &[(&str, &str)], rows: &[(String, Vec<u64>)]) -> String {
    const LEFT: f64 = 250.0;
    const BAR: f64 = 460.0;
    const ROW: f64 = 26.0;
    let legend_rows = kinds.len().div_ceil(5) as f64;
    let top = 12.0 + legend_rows * 20.0;
    let mut svg = Svg::new(LEFT + BAR + 60.0, top + rows.len() as f64 * ROW + 24.0);
    for (i, (kind, colour)) in kinds.iter().enumerate() {
        let (x, y) = (10.0 + (i % 5) as f64 * 148.0, 8.0 + (i / 5) as f64 * 20.0);
        svg.bar((x, y), (12.0, 12.0), colour, kind);
        svg.text(x + 17.0, y + 10.5, "start", kind);
    }
    for (i, (name, counts)) in rows.iter().enumerate() {
        let y = top + i as f64 * ROW;
        svg.text(LEFT - 8.0, y + 15.0, "end", name);
        let all = counts.iter().sum::<u64>().max(1) as f64;
        let mut x = LEFT;
        for ((kind, colour), &n) in kinds.iter().zip(counts).filter(|(_, n)| **n > 0) {
            let width = BAR * n as f64 / all;
            svg.bar((x, y), (width, ROW - 6.0), colour, &format!("{kind}: {n} of {all:.0}"));
            if width > 30.0 {
                svg.text(x + 0.5 * width, y + 14.5, "middle", &format!("{:.0} %", 100.0 * n as f64 / all));
            }
            x += width;
        }
        svg.text(LEFT + BAR + 8.0, y + 15.0, "start", &format!("n {all:.0}"));
    }
    svg.finish()
}

/// Lines over a common axis of bins `step` wide: shares of each line's sum, in percent.
pub fn distribution(title: &str, unit: &str, step: f64, lines: &[(String, Vec<u64>)]) -> String {
    let line = |(name, counts): &(String, Vec<u64>)| {
        let all = counts.iter().sum::<u64>();
        let shares = counts.iter().map(|n| 100.0 * *n as f64 / all as f64).enumerate();
        let steps = shares.flat_map(|(bin, share)| [bin, bin + 1].map(|edge| (step * edge as f64, share)));
        (all > 0).then(|| Line { name: name.clone(), points: steps.collect(), band: Vec::new() })
    };
    let bins = lines.iter().map(|(_, counts)| counts.len()).max().unwrap_or(0);
    let chart = Chart {
        title: title.to_string(),
        x: format!("{unit} (all above {:.0} in the last step)", step * bins.saturating_sub(1) as f64),
        y: "%".to_string(),
        lines: lines.iter().filter_map(line).collect(),
    };
    chart.svg()
}

/// A chart: lines over a common x axis.
pub struct Chart {
    /// The title.
    pub title: String,
    /// Label of the x axis.
    pub x: String,
    /// Label of the y axis.
    pub y: String,
    /// The lines.
    pub lines: Vec<Line>,
}

/// A line with its name; points that are not finite leave a gap.
pub struct Line {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y).
    pub points: Vec<(f64, f64)>,
    /// A shaded range: x, lowest y, highest y; may be empty.
    pub band: Vec<[f64; 3]>,
}

impl Line {
    /// `f` over `n` evenly spaced points.
    pub fn of(name: &str, (from, to): (f64, f64), n: usize, f: impl Fn(f64) -> f64) -> Self {
        let at = |i: usize| from + (to - from) * i as f64 / (n.max(2) - 1) as f64;
        let points = (0..n.max(2)).map(|i| (at(i), f(at(i)))).collect();
        Self { name: name.to_string(), points, band: Vec::new() }
    }
}

const WIDTH: f64 = 560.0;
const PLOT_HEIGHT: f64 = 260.0;
const LEFT: f64 = 62.0;
const TOP: f64 = 34.0;
const RIGHT: f64 = 24.0;
const BOTTOM: f64 = 46.0;
const LEGEND_ROW: f64 = 17.0;

impl Chart {
    /// The chart as an SVG document.
    pub fn svg(&self) -> String {
        let all =
            || self.lines.iter().flat_map(|line| &line.points).filter(|p| p.0.is_finite() && p.1.is_finite());
        let bands = || self.lines.iter().flat_map(|line| &line.band).flat_map(|b| [b[1], b[2]]);
        let x = Axis::around(all().map(|p| p.0), false);
        let y = Axis::around(all().map(|p| p.1).chain(bands()), true);
        let (right, foot) = (WIDTH - RIGHT, TOP + PLOT_HEIGHT);
        let px = |v: f64| LEFT + x.share(v) * (right - LEFT);
        let py = |v: f64| TOP + (1.0 - y.share(v)) * PLOT_HEIGHT;
        let mut svg = Svg::new(WIDTH, foot + BOTTOM + self.lines.len() as f64 * LEGEND_ROW);
        svg.push(format_args!("<rect width=\"100%\" height=\"100%\" fill=\"white\"/>"));
        svg.styled(14.0, 20.0, "start", " font-size=\"14\" font-weight=\"bold\"", &self.title);
        svg.text(0.5 * (LEFT + right), foot + 36.0, "middle", &self.x);
        let middle = TOP + 0.5 * PLOT_HEIGHT;
        svg.styled(14.0, middle, "middle", &format!(" transform=\"rotate(-90 14 {middle})\""), &self.y);
        for tick in x.ticks() {
            svg.text(px(tick), foot + 17.0, "middle", &x.label(tick));
            svg.rule((px(tick), TOP), (px(tick), foot), "#e4e4e4", 1.0);
        }
        for tick in y.ticks() {
            let colour = if tick.abs() < 1e-9 { "#888888" } else { "#e4e4e4" };
            svg.text(LEFT - 6.0, py(tick) + 4.0, "end", &y.label(tick));
            svg.rule((LEFT, py(tick)), (right, py(tick)), colour, 1.0);
        }
        for (i, line) in self.lines.iter().enumerate() {
            let colour = COLOURS[i % COLOURS.len()];
            let at = foot + BOTTOM + 6.0 + i as f64 * LEGEND_ROW;
            svg.text(LEFT + 28.0, at + 4.0, "start", &line.name);
            svg.rule((LEFT, at), (LEFT + 22.0, at), colour, 3.0);
            if !line.band.is_empty() {
                let upper = line.band.iter().map(|b| (px(b[0]), py(b[2])));
                let lower = line.band.iter().rev().map(|b| (px(b[0]), py(b[1])));
                svg.area(upper.chain(lower), colour);
            }
            for run in line.points.split(|p| !p.0.is_finite() || !p.1.is_finite()) {
                let points: Vec<_> = run.iter().map(|p| (px(p.0), py(p.1))).collect();
                svg.line(&points, colour, 2.0);
            }
        }
        svg.finish()
    }
}

/// A range with round ticks.
struct Axis {
    low: f64,
    high: f64,
    step: f64,
}

impl Axis {
    /// The range of all values; with `room` a little more.
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
    fn figures_hold_what_they_show() {
        let svg = stacked(&[("arrival", "#009e73"), ("a<b", "#d55e00")], &[("wad-t".into(), vec![3, 1])]);
        assert!(svg.contains("75 %") && svg.contains("a&lt;b: 1 of 4") && svg.contains("n 4"), "{svg}");
        let svg = distribution(
            "speeds",
            "km/h",
            5.0,
            &[("x".into(), vec![1, 3, 0]), ("nobody".into(), vec![0, 0])],
        );
        assert_eq!(svg.matches("<polyline").count(), 1);
        assert!(svg.contains("all above 10"), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("nobody"), "{svg}");
    }

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
