//! Exit codes, and errors that carry one to `main`.

use std::fmt;
use std::process::ExitCode;
use wad_cosim::assets::AssetsError;
use wad_cosim::dataset::DatasetError;
use wad_cosim::drive::DriveError;
use wad_cosim::env::EnvError;

/// The process's exit codes. The numbers are part of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done.
    Done = 0,
    /// Anything not named below.
    Other = 1,
    /// The command line or an input file is wrong.
    Input = 2,
    /// SUMO is missing, too old, crashed or hung.
    Sumo = 3,
    /// Interrupted; the results so far are kept.
    Interrupted = 4,
}

impl Exit {
    /// The code that `error` carries, or [`Exit::Other`].
    pub fn of(error: &anyhow::Error) -> Self {
        error.chain().find_map(|cause| cause.downcast_ref::<Failure>()).map_or(Self::Other, |f| f.exit)
    }

    /// The code of a town that cannot be read.
    pub fn of_assets(error: &AssetsError) -> Self {
        if error.is_input() { Self::Input } else { Self::Sumo }
    }

    /// The code of an environment's error.
    pub fn of_env(error: &EnvError) -> Self {
        Self::blamed(error.is_input(), error.is_sumo())
    }

    /// The code of a drive's error.
    pub fn of_drive(error: &DriveError) -> Self {
        Self::blamed(error.is_input(), error.is_sumo())
    }

    /// The code of a dataset's error.
    pub fn of_dataset(error: &DatasetError) -> Self {
        Self::blamed(error.is_input(), error.is_sumo())
    }

    /// The code where the input is to blame, or SUMO, or neither.
    pub fn blamed(is_input: bool, is_sumo: bool) -> Self {
        match (is_input, is_sumo) {
            (true, _) => Self::Input,
            (_, true) => Self::Sumo,
            _ => Self::Other,
        }
    }

    /// Make `error` end the process with this code. Its message does not change.
    pub fn because(self, error: impl Into<anyhow::Error>) -> anyhow::Error {
        anyhow::Error::new(Failure { exit: self, error: error.into() })
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// An error with an exit code; its message is the error inside.
///
/// `load(path).map_err(|e| Exit::Input.because(e))?` is the usual way to make one; context
/// may be added over it.
#[derive(Debug)]
pub struct Failure {
    exit: Exit,
    error: anyhow::Error,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.error.fmt(f)
    }
}

impl std::error::Error for Failure {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.error.source()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::{Context, anyhow};

    #[test]
    fn code_survives_context_and_message_is_not_doubled() {
        let cause = anyhow!("no such file").context("cannot read town5.net.xml");
        let error = Err::<(), _>(Exit::Input.because(cause)).context("cannot start the run").unwrap_err();
        assert_eq!(Exit::of(&error), Exit::Input);
        assert_eq!(format!("{error:#}"), "cannot start the run: cannot read town5.net.xml: no such file");
    }

    #[test]
    fn error_without_code_ends_with_1() {
        assert_eq!(Exit::of(&anyhow!("odd")), Exit::Other);
    }
}
