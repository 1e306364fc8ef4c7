//! `info`: an environment's numbers and news as Python's dictionary. It is made at every step, so here and not in Python.

use crate::episode::{FACTS, NUMBERS, News, TERMS, WHOLE};
use numpy::{PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyAny, PyDict, PyString};

/// The names of the numbers as Python's texts.
static NAMES: PyOnceLock<Vec<Py<PyString>>> = PyOnceLock::new();

/// The facts of a tick, and the reward's terms by name.
pub fn of<'py>(py: Python<'py>, numbers: &[f64]) -> PyResult<Bound<'py, PyDict>> {
    let names = NAMES.get_or_init(py, || {
        NUMBERS.iter().map(|name| PyString::intern(py, name).unbind()).collect::<Vec<_>>()
    });
    let info = PyDict::new(py);
    let named = || names.iter().zip(numbers);
    for (index, (name, number)) in named().enumerate().take(TERMS).skip(FACTS) {
        if WHOLE.contains(&index) {
            info.set_item(name, *number as u64)?;
        } else {
            info.set_item(name, number)?;
        }
    }
    let terms = PyDict::new(py);
    for (name, number) in named().skip(TERMS) {
        terms.set_item(name, number)?;
    }
    info.set_item(intern!(py, "reward_terms"), terms)?;
    Ok(info)
}

/// Adds what seldom happens.
pub fn add_news(py: Python<'_>, info: &Bound<'_, PyDict>, news: &News) -> PyResult<()> {
    if !news.events.is_empty() {
        info.set_item(intern!(py, "events"), json(py, &news.events)?)?;
    }
    if let Some(ending) = &news.ending {
        info.set_item(intern!(py, "end"), ending.end.name())?;
        info.set_item(intern!(py, "cause"), &ending.cause)?;
        info.set_item(intern!(py, "success"), ending.success)?;
    }
    Ok(())
}

/// A value as Python's dictionaries, lists and numbers; seldom needed, so the way over text is short enough.
pub fn json<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (crate::held::json(value)?,))
}

/// The `info` of an environment's row of numbers.
#[pyfunction]
pub fn info_of<'py>(py: Python<'py>, numbers: PyReadonlyArray1<'py, f64>) -> PyResult<Bound<'py, PyDict>> {
    match numbers.as_slice() {
        Ok(row) if row.len() == NUMBERS.len() => of(py, row),
        _ => {
            let shape = numbers.shape();
            let text = format!("numbers of shape {shape:?}: expected {} in a row", NUMBERS.len());
            Err(crate::errors::InputError::new_err(text))
        }
    }
}
