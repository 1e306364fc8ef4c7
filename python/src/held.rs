//! What Python holds until it is finished, and texts in JSON.

use crate::errors::Failure;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::{Mutex, PoisonError};

/// A value of Python's text.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, Failure> {
    serde_json::from_str(text).map_err(|e| Failure::Input(e.to_string()))
}

/// A value as text.
pub fn json(value: &impl Serialize) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(|e| Failure::Other(e.to_string()))
}

/// A value that is there until it is finished.
pub struct Held<T> {
    /// Its name in an error.
    name: &'static str,
    value: Mutex<Option<T>>,
}

impl<T> Held<T> {
    pub fn new(name: &'static str, value: T) -> Self {
        Self { name, value: Mutex::new(Some(value)) }
    }

    /// With the value, unless it is finished.
    pub fn with<R>(&self, then: impl FnOnce(&mut T) -> Result<R, Failure>) -> Result<R, Failure> {
        let mut value = self.value.lock().unwrap_or_else(PoisonError::into_inner);
        then(value.as_mut().ok_or_else(|| self.finished())?)
    }

    /// The value; it is finished from now on.
    pub fn finish(&self) -> Result<T, Failure> {
        self.value.lock().unwrap_or_else(PoisonError::into_inner).take().ok_or_else(|| self.finished())
    }

    fn finished(&self) -> Failure {
        Failure::Other(format!("{} is finished", self.name))
    }
}
