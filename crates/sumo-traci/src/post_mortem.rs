//! How a SUMO process ended, as errors quote it.

use std::fmt;
use std::path::PathBuf;
use std::process::ExitStatus;

/// How SUMO ended.
#[derive(Clone, Debug)]
pub struct PostMortem {
    /// None where it still runs.
    pub status: Option<ExitStatus>,
    /// The last lines of its log.
    pub log: String,
    /// The whole log, where it is kept.
    pub log_file: Option<PathBuf>,
}

impl fmt::Display for PostMortem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.status {
            Some(status) => write!(f, "SUMO ended with {status}")?,
            None => write!(f, "SUMO still runs")?,
        }
        match self.log.is_empty() {
            true => write!(f, "; its log is empty")?,
            false => write!(f, "; its log ends with\n{}", self.log)?,
        }
        match &self.log_file {
            Some(path) => write!(f, "\n(whole log: {})", path.display()),
            None => Ok(()),
        }
    }
}
