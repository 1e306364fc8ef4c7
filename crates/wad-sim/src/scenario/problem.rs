//! A scenario's mistakes: file, element, and what to do.

use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// One mistake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The file with the mistake.
    pub file: PathBuf,
    /// From 1; None if it is about the file as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
    /// Tag and id, e.g. ``trip `ego` ``; empty if it is about the file as a whole.
    pub element: String,
    /// What is wrong.
    pub what: String,
    /// The remedy.
    pub fix: String,
}

impl Problem {
    /// About a whole file.
    pub fn of_file(file: &Path, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            file: file.to_path_buf(),
            line: None,
            element: String::new(),
            what: what.into(),
            fix: fix.into(),
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if !self.element.is_empty() {
            write!(f, ": {}", self.element)?;
        }
        write!(f, ": {}; {}", self.what, self.fix)
    }
}

/// A scenario with mistakes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", list(.0))]
pub struct ScenarioError(pub Vec<Problem>);

fn list(problems: &[Problem]) -> String {
    let lines: Vec<String> = problems.iter().map(ToString::to_string).collect();
    match lines.as_slice() {
        [one] => one.clone(),
        many => format!("the scenario has {} mistakes:\n  {}", many.len(), many.join("\n  ")),
    }
}

/// The entries of `names` nearest to `found`, nearest first, for "did you mean".
pub fn near<'a>(found: &str, names: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let folded = |s: &str| s.replace(['-', '_', '.', ' '], "").to_ascii_lowercase();
    let wanted = folded(found);
    let mut near: Vec<(usize, &str)> = names
        .into_iter()
        .map(|name| (wad_camera::distance(&wanted, &folded(name)), name))
        .filter(|(distance, name)| *distance <= 1 + name.len() / 4)
        .collect();
    near.sort();
    near.into_iter().take(3).map(|(_, name)| name).collect()
}

/// "did you mean X?" where something is near, else the whole list.
pub fn meant(found: &str, names: &[&str]) -> String {
    let near = near(found, names.iter().copied());
    if near.is_empty() {
        format!("expected one of {}", names.join(", "))
    } else {
        format!("did you mean {}?", near.join(" or "))
    }
}
