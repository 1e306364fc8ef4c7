//! The package's exceptions. Their texts are those of the command line.

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use wad_cosim::assets::AssetsError;
use wad_cosim::env::EnvError;

pyo3::create_exception!(wad_cosim, Error, PyRuntimeError, "The simulator failed, or was used out of order.");
pyo3::create_exception!(wad_cosim, SumoError, Error, "SUMO is missing, did not start or died.");
pyo3::create_exception!(
    wad_cosim,
    InputError,
    PyValueError,
    "An argument is wrong; the text says what is expected."
);

/// Adds the exceptions to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Error", module.py().get_type::<Error>())?;
    module.add("SumoError", module.py().get_type::<SumoError>())?;
    module.add("InputError", module.py().get_type::<InputError>())
}

/// Why something was not done, for the thread that asked.
#[derive(Clone, Debug)]
pub enum Failure {
    /// The user's input is wrong.
    Input(String),
    /// SUMO failed.
    Sumo(String),
    /// Anything else.
    Other(String),
}

impl Failure {
    /// What it says.
    pub fn text(&self) -> &str {
        match self {
            Self::Input(text) | Self::Sumo(text) | Self::Other(text) => text,
        }
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Input(text) => InputError::new_err(text),
            Failure::Sumo(text) => SumoError::new_err(text),
            Failure::Other(text) => Error::new_err(text),
        }
    }
}

impl From<EnvError> for Failure {
    fn from(error: EnvError) -> Self {
        let text = error.to_string();
        match error {
            _ if error.is_input() => Self::Input(text),
            _ if error.is_sumo() => Self::Sumo(text),
            // The detector or the encoder has no such name or file, or needs another build.
            EnvError::Eyes(_) => Self::Input(text),
            _ => Self::Other(text),
        }
    }
}

impl From<AssetsError> for Failure {
    fn from(error: AssetsError) -> Self {
        if error.is_input() { Self::Input(error.to_string()) } else { Self::Sumo(error.to_string()) }
    }
}
