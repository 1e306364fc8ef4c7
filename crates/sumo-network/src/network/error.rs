//! Why a network or a SUMO additional file could not be read.

use super::permissions::VehicleClass;
use std::path::PathBuf;

/// Why a network could not be used.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The file cannot be opened or read.
    #[error("cannot read {}: {source}; check the path and that the file may be read", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A gzip file that is damaged, cut off or too large.
    #[error("cannot unpack {}: {source}; the gzip file is damaged, cut off or too large: fetch or build it again", path.display())]
    Compressed {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        source: std::io::Error,
    },
    /// Not well-formed XML.
    #[error("{}:{line}: not XML: {message}; expected a SUMO network (.net.xml or .net.xml.gz)", path.display())]
    Xml {
        /// The file.
        path: PathBuf,
        /// Line in it, from 1.
        line: usize,
        /// What the XML parser says.
        message: String,
    },
    /// XML of another kind.
    #[error("{}: expected a SUMO network with root element <net>, found <{found}>; name the .net.xml file", path.display())]
    NotANet {
        /// The file.
        path: PathBuf,
        /// Name of its root element.
        found: String,
    },
    /// The file ends inside an element.
    #[error("{}:{line}: the file ends inside <{element}>: it is cut off; build or fetch it again", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Line in it, from 1.
        line: usize,
        /// The element that is open at the end.
        element: String,
    },
    /// A needed attribute is missing.
    #[error("{}:{line}: <{element}> `{id}` has no attribute `{attribute}`, which SUMO needs; build the net again with netconvert", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// Line in it, from 1.
        line: usize,
        /// The element's name.
        element: &'static str,
        /// Its id; empty where it has none.
        id: String,
        /// The attribute that is missing.
        attribute: &'static str,
    },
    /// An attribute's value cannot be understood.
    #[error("{}:{line}: {element} {attribute}=\"{value}\": expected {expected}", path.display())]
    BadValue {
        /// The file.
        path: PathBuf,
        /// Line in it, from 1.
        line: usize,
        /// The element's name.
        element: &'static str,
        /// The attribute's name.
        attribute: &'static str,
        /// What it says.
        value: String,
        /// What it may say.
        expected: &'static str,
    },
    /// Something names an element that the file does not have.
    #[error("{}:{line}: <{element}> names the {kind} `{id}`, which the file does not have; build the net again with netconvert", path.display())]
    DanglingReference {
        /// The file.
        path: PathBuf,
        /// Line in it, from 1.
        line: usize,
        /// The element that names it.
        element: &'static str,
        /// What is named: an edge, a lane, ...
        kind: &'static str,
        /// The id that nothing has.
        id: String,
    },
    /// Nothing to drive on.
    #[error(
        "no drivable lane for class {class}: none of the net's {lanes} road lanes allows it; use another net or another vehicle class"
    )]
    NoDrivableLane {
        /// The vehicle class.
        class: VehicleClass,
        /// How many lanes its roads have.
        lanes: usize,
    },
}
