//! Nets from other sources: facts and problems of a net, and SUMO's tools that build, import and enrich nets.
//!
//! ```text
//! plain XML, OpenDRIVE, OSM, a bare net --build, import, enrich--> NAME.net.xml, NAME.poly.xml, NAME.sumocfg
//! ```
//!
//! netconvert and polyconvert of the SUMO that drives do the work. This module chooses their options and
//! checks that lanes stay in place.

mod enrich;
mod info;
mod make;
mod restore;

pub use enrich::{Enriched, Wanted, enrich};
pub use info::{Facts, NetProblem, TaskPlaces, facts};
pub use make::{Made, build, import};
pub use restore::{Moved, compare};

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use sumo_network::network::NetworkError;
use sumo_traci::process::{InstallError, SumoInstall};

/// Why a net could not be made.
#[derive(Debug, thiserror::Error)]
pub enum NetError {
    /// SUMO is not installed, or its version is too old.
    #[error(transparent)]
    Install(#[from] InstallError),
    /// The net cannot be read.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The target exists.
    #[error("{} exists already: name another folder with --out, or remove it first", path.display())]
    Taken {
        /// The target's folder.
        path: PathBuf,
    },
    /// The given file is not a map or net that can be imported.
    #[error("`{}` is not a source of a net: expected {expected}", path.display())]
    Source {
        /// The given file.
        path: PathBuf,
        /// The kinds of files that can be.
        expected: &'static str,
    },
    /// netconvert or polyconvert failed.
    #[error("{tool} failed on {}: {said}", path.display())]
    Tool {
        /// The tool's name.
        tool: &'static str,
        /// The file that it worked on.
        path: PathBuf,
        /// Its last messages.
        said: String,
    },
    /// Enriching would move lanes away from their lines, or lose some.
    #[error("{0}: nothing is written")]
    Moved(Moved),
    /// A net's XML has another form than netconvert's.
    #[error("`{}` is not XML as netconvert writes it: {problem}", path.display())]
    Malformed {
        /// The net.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The net has everything that enriching adds.
    #[error("nothing to add to `{}`: it has signals, sidewalks and crossings already; ask for more of them with --signals, --sidewalks, --crossings", path.display())]
    Nothing {
        /// The net.
        path: PathBuf,
    },
}

/// Runs one of SUMO's tools; `about` is what an error names. Returns its warnings.
fn run(
    install: &SumoInstall,
    tool: &'static str,
    about: &Path,
    arguments: Vec<OsString>,
) -> Result<Vec<String>, NetError> {
    let fail = |said: String| NetError::Tool { tool, path: about.to_path_buf(), said };
    let output = install.command(tool).args(arguments).output().map_err(|error| fail(error.to_string()))?;
    let text = String::from_utf8_lossy(&output.stderr);
    let of = |begin: &str| -> Vec<String> {
        text.lines().filter_map(|line| Some(line.strip_prefix(begin)?.trim().to_string())).collect()
    };
    if !output.status.success() {
        let errors = of("Error:");
        let said = if errors.is_empty() { text.trim().to_string() } else { errors.join("; ") };
        return Err(fail(said));
    }
    Ok(of("Warning:"))
}

/// `--option value` pairs as arguments.
fn arguments(pairs: &[(&str, &str)]) -> Vec<OsString> {
    pairs
        .iter()
        .flat_map(|(option, value)| [OsString::from(format!("--{option}")), OsString::from(value)])
        .collect()
}
