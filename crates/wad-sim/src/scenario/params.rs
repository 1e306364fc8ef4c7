//! The generic parameters `wad.*`: which element takes which, and how their values are read.

use super::problem::Problem;
use super::xml::Element;
use crate::suggest::{meant, near};

/// Prefix of all our parameters.
pub const PREFIX: &str = "wad.";

/// Parameters of the ego.
pub const EGO: &[&str] =
    &[DESCRIPTION, "wad.task", "wad.destination", "wad.via", "wad.weather", "wad.traffic", "wad.time_limit"];

/// The ego's parameter that describes the scenario in a line.
pub const DESCRIPTION: &str = "wad.description";

/// Reads the parameters of one element, and collects what is wrong with them.
pub struct Reader<'a> {
    pub element: &'a Element,
    pub problems: &'a mut Vec<Problem>,
}

impl Reader<'_> {
    /// Complains of every parameter that is not among `known`.
    pub fn only(&mut self, known: &[&str]) {
        for param in &self.element.params {
            if known.contains(&param.key.as_str()) {
                continue;
            }
            let ours = param.key.starts_with(PREFIX);
            // `weather`, `WAD.weather`, `wad_weather` were meant for ours; anything else is the author's own.
            let close = near(&format!("{PREFIX}{}", param.key), known.iter().copied());
            let close = if close.is_empty() { near(&param.key, known.iter().copied()) } else { close };
            if !ours && close.is_empty() {
                continue;
            }
            let fix = match (close.is_empty(), known.is_empty()) {
                (false, _) => format!("did you mean {}?", close.join(" or ")),
                (true, false) => format!("it takes {}", known.join(", ")),
                (true, true) => "it takes none; remove it".to_string(),
            };
            let mut problem = self.element.problem(format!("unknown parameter `{}`", param.key), fix);
            problem.line = Some(param.line);
            self.problems.push(problem);
        }
    }

    pub fn wrong(&mut self, what: impl Into<String>, fix: impl Into<String>) {
        self.problems.push(self.element.problem(what, fix));
    }

    /// A number from `low` to `high`, or `default` where the parameter is missing or wrong.
    pub fn number(&mut self, key: &str, default: f64, low: f64, high: f64, unit: &str) -> f64 {
        self.optional(key, low, high, unit).unwrap_or(default)
    }

    /// The same without a default.
    pub fn optional(&mut self, key: &str, low: f64, high: f64, unit: &str) -> Option<f64> {
        let text = self.element.param(key)?;
        match text.parse::<f64>() {
            Ok(value) if (low..=high).contains(&value) => Some(value),
            _ => {
                let (what, fix) = (
                    format!("`{key}` is `{text}`"),
                    format!("expected a number of {unit} from {low} to {high}"),
                );
                self.wrong(what, fix);
                None
            }
        }
    }

    /// One of `names`, or `default`.
    pub fn choice(&mut self, key: &str, names: &[&'static str], default: &'static str) -> &'static str {
        let Some(text) = self.element.param(key) else { return default };
        self.one_of(key, text, names).unwrap_or(default)
    }

    /// The one of `names` that `text` is.
    pub fn one_of(&mut self, key: &str, text: &str, names: &[&'static str]) -> Option<&'static str> {
        let found = names.iter().copied().find(|name| *name == text);
        if found.is_none() {
            self.wrong(format!("`{key}` is `{text}`"), meant(text, names));
        }
        found
    }
}
