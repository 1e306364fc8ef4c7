//! The document that a network is read from, for errors that name file and line.

use super::error::NetworkError;
use super::xml::Walk;
use std::path::Path;

/// Where errors are reported to.
pub(super) struct Source<'a> {
    pub path: &'a Path,
    pub text: &'a str,
}

impl Source<'_> {
    /// The error for an element that names what the file does not have.
    pub(super) fn dangling(
        &self,
        position: u64,
        element: &'static str,
        kind: &'static str,
        id: &str,
    ) -> NetworkError {
        NetworkError::DanglingReference {
            path: self.path.to_owned(),
            line: Walk::new(self.path, self.text).line_of(position),
            element,
            kind,
            id: id.to_owned(),
        }
    }

    /// The error for a lane that a junction names in vain.
    pub(super) fn no_lane(&self, position: u64, id: &str) -> NetworkError {
        self.dangling(position, "junction", "lane", id)
    }
}
