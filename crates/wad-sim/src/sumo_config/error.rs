//! Why a configuration cannot be used.

use std::path::PathBuf;
use sumo_network::network::NetworkError;

/// Why a configuration could not be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("could not read `{}`: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A file that the configuration names cannot be read.
    #[error(transparent)]
    File(#[from] NetworkError),
    /// The file is not a SUMO configuration.
    #[error("`{}` is not a SUMO configuration: {problem}; expected XML with a <net-file value=\"...\"/>", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A file that the configuration names is no XML that SUMO reads.
    #[error("`{}` is not a file for SUMO: {problem}; expected XML", path.display())]
    NotXml {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The configuration has no `net-file`.
    #[error("`{}` names no net-file; add <net-file value=\"...\"/> to its <input>", path.display())]
    NoNet {
        /// The configuration.
        path: PathBuf,
    },
    /// The configuration names a file that does not exist.
    #[error("`{}` names {option} `{}`, which does not exist (paths count from the config's folder)", config.display(), missing.display())]
    MissingInput {
        /// The configuration.
        config: PathBuf,
        /// The option that names the file.
        option: String,
        /// The file.
        missing: PathBuf,
    },
    /// An option has an unusable value.
    #[error("`{}` gives {option} the value `{value}`; expected {expected}", path.display())]
    BadValue {
        /// The configuration.
        path: PathBuf,
        /// The option.
        option: String,
        /// The value found.
        value: String,
        /// The values that can be used.
        expected: &'static str,
    },
    /// A file cannot be written.
    #[error("could not write `{}`: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// SUMO takes a path apart that has one of these characters.
    #[error("SUMO cannot use the path `{}`: it has {found}; rename the folder or file", path.display())]
    Path {
        /// The path.
        path: PathBuf,
        /// What is in it.
        found: &'static str,
    },
    /// SUMO does not list its options.
    #[error("could not ask SUMO at `{}` for its options: {problem}", binary.display())]
    Schema {
        /// SUMO's program.
        binary: PathBuf,
        /// What went wrong.
        problem: String,
    },
}
