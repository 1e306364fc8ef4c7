//! Step-by-step learning for the trainer in Python: curricula are read, and progress in them is noted, as `train agent` does.

use crate::errors::Failure;
use crate::held::{json, parse};
use pyo3::prelude::*;
use std::path::PathBuf;
use wad_cosim::tasks::{Curriculum, Progress};

/// Checks a curriculum's text; `name` is what errors call it.
#[pyfunction]
pub fn check_curriculum(text: &str, name: PathBuf) -> PyResult<()> {
    Curriculum::parse(&name, text).map_err(|error| Failure::Input(error.to_string()))?;
    Ok(())
}

/// How a stage was left: its number, whether by its threshold, steps spent in it, share of its last episodes that were successful.
type Left = (usize, bool, u64, f64);

/// Notes an episode of the stage `drawn` in a progress: the progress after it, and how a stage was left where the episode ends it.
/// Curriculum and progress are JSON.
#[pyfunction]
pub fn note_episode(
    curriculum: &str,
    progress: &str,
    drawn: usize,
    steps: u64,
    success: bool,
) -> PyResult<(String, Option<Left>)> {
    let (curriculum, mut progress): (Curriculum, Progress) = (parse(curriculum)?, parse(progress)?);
    let passed = progress.note(&curriculum, drawn, steps, success);
    let left = passed.map(|passed| (passed.stage, passed.threshold, passed.steps, passed.rate));
    Ok((json(&progress)?, left))
}
