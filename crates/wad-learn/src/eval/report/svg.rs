//! Figures as SVG, without a library.

use std::fmt::Write;

/// Colours that are told apart by those who see red and green alike (Okabe and Ito).
pub const COLOURS: [&str; 8] =
    ["#009e73", "#56b4e9", "#d55e00", "#cc79a7", "#e69f00", "#f0e442", "#0072b2", "#777777"];

/// Colours of lines that are easily told apart, in order.
const LINES: [usize; 7] = [6, 2, 0, 3, 4, 1, 7];

/// A drawing under way.
pub struct Svg {
    width: f64,
    height: f64,
    body: String,
}

/// Text as SVG and HTML want it.
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
        self.push(format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>",
            escape(words)
        ));
    }

    /// A filled rectangle that says `title` when pointed at.
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

    pub fn dot(&mut self, (x, y): (f64, f64), radius: f64, fill: &str, title: &str) {
        self.push(format_args!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{fill}\" stroke=\"white\" stroke-width=\"0.7\"><title>{}</title></circle>",
            escape(title)
        ));
    }

    /// The drawing, to stand in a page.
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
    const LEFT: f64 = 48.0;
    const WIDTH: f64 = 420.0;
    const HEIGHT: f64 = 190.0;
    const TOP: f64 = 30.0;
    let shares: Vec<(&String, Vec<f64>)> = lines
        .iter()
        .filter(|(_, counts)| counts.iter().sum::<u64>() > 0)
        .map(|(name, counts)| {
            let all = counts.iter().sum::<u64>() as f64;
            (name, counts.iter().map(|n| 100.0 * *n as f64 / all).collect())
        })
        .collect();
    let most = shares.iter().flat_map(|(_, s)| s).copied().fold(1.0_f64, f64::max);
    let top = [5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0].into_iter().find(|t| *t >= most).unwrap_or(100.0);
    let bins = shares.iter().map(|(_, s)| s.len()).max().unwrap_or(1).max(2);
    let x = |bin: f64| LEFT + WIDTH * bin / bins as f64;
    let y = |share: f64| TOP + HEIGHT * (1.0 - share / top);
    let mut svg = Svg::new(LEFT + WIDTH + 20.0, TOP + HEIGHT + 44.0 + 18.0 * shares.len() as f64);
    svg.text(LEFT, 18.0, "start", title);
    for tick in 0..=4 {
        let share = top * f64::from(tick) / 4.0;
        svg.line(&[(LEFT, y(share)), (LEFT + WIDTH, y(share))], "#dddddd", 1.0);
        svg.text(LEFT - 6.0, y(share) + 4.0, "end", &format!("{share:.0} %"));
    }
    for bin in (0..=bins).step_by(2) {
        let last = bin + 1 >= bins;
        svg.text(
            x(bin as f64),
            TOP + HEIGHT + 16.0,
            "middle",
            &format!("{:.0}{}", bin as f64 * step, if last { "+" } else { "" }),
        );
    }
    svg.text(LEFT + 0.5 * WIDTH, TOP + HEIGHT + 34.0, "middle", unit);
    for (i, (name, share)) in shares.iter().enumerate() {
        let colour = COLOURS[LINES[i % LINES.len()]];
        let steps = share
            .iter()
            .enumerate()
            .flat_map(|(bin, s)| [(x(bin as f64), y(*s)), (x(bin as f64 + 1.0), y(*s))]);
        svg.line(&steps.collect::<Vec<_>>(), colour, 2.0);
        let at = TOP + HEIGHT + 50.0 + 18.0 * i as f64;
        svg.bar((LEFT, at - 9.0), (18.0, 4.0), colour, name);
        svg.text(LEFT + 26.0, at - 2.0, "start", name);
    }
    svg.finish()
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
        assert_eq!(svg.matches("<polyline").count(), 5 + 1);
        assert!(!svg.contains("NaN") && !svg.contains("nobody"), "{svg}");
    }
}
