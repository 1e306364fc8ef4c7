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
