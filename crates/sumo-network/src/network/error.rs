//! Why a network or a SUMO additional file could not be read.

use super::permissions::VehicleClass;
use std::path::PathBuf;

/// Why a network could not be used.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The file cannot be opened or read.
    #[error("cannot read {}: {source}; check the path and that the file may be read", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    /// A gzip file that is damaged or cut off.
    #[error("cannot unpack {}: {source}; the gzip file is damaged or cut off, fetch or build it again", path.display())]
    Compressed { path: PathBuf, source: std::io::Error },
    /// Not well-formed XML.
    #[error("{}:{line}: not XML: {message}; expected a SUMO network (.net.xml or .net.xml.gz)", path.display())]
    Xml { path: PathBuf, line: usize, message: String },
    /// XML of another kind.
    #[error("{}: expected a SUMO network with root element <net>, found <{found}>; name the .net.xml file", path.display())]
    NotANet { path: PathBuf, found: String },
    /// The file ends inside an element.
    #[error("{}:{line}: the file ends inside <{element}>: it is cut off; build or fetch it again", path.display())]
    Truncated { path: PathBuf, line: usize, element: String },
    /// A needed attribute is missing.
    #[error("{}:{line}: <{element}> `{id}` has no attribute `{attribute}`, which SUMO needs; build the net again with netconvert", path.display())]
    Missing { path: PathBuf, line: usize, element: &'static str, id: String, attribute: &'static str },
    /// An attribute's value cannot be understood.
    #[error("{}:{line}: {element} {attribute}=\"{value}\": expected {expected}", path.display())]
    BadValue {
        path: PathBuf,
        line: usize,
        element: &'static str,
        attribute: &'static str,
        value: String,
        expected: &'static str,
    },
    /// Something names an element that the file does not have.
    #[error("{}:{line}: <{element}> names the {kind} `{id}`, which the file does not have; build the net again with netconvert", path.display())]
    DanglingReference { path: PathBuf, line: usize, element: &'static str, kind: &'static str, id: String },
    /// Nothing to drive on.
    #[error(
        "no drivable lane for class {class}: none of the net's {lanes} road lanes allows it; use another net or another vehicle class"
    )]
    NoDrivableLane { class: VehicleClass, lanes: usize },
}
