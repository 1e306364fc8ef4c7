//! Nets built from plain sources, and imported from OpenDRIVE, OpenStreetMap and other SUMO nets.

use super::{NetError, arguments, run};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use sumo_network::network::{Network, read_bytes};
use sumo_traci::process::SumoInstall;

/// A folder that `run` takes.
#[derive(Clone, Debug)]
pub struct Made {
    /// `NAME.sumocfg`.
    pub config: PathBuf,
    /// The net that it names.
    pub net: PathBuf,
    /// The polygons that it names, if there are any.
    pub polygons: Option<PathBuf>,
    /// Warnings of netconvert and polyconvert.
    pub warnings: Vec<String>,
}

/// Options for every net that is made: what a camera and a driver need of one.
const COMMON: &[(&str, &str)] = &[
    ("no-turnarounds.except-deadend", "true"),
    ("junctions.corner-detail", "5"),
    ("junctions.internal-link-detail", "8"),
    ("walkingareas", "true"),
    ("no-warnings", "false"),
];

/// OpenStreetMap: signals where the map has them, sidewalks and crossings where it would.
const OSM: &[(&str, &str)] = &[
    ("geometry.remove", "true"),
    ("ramps.guess", "true"),
    ("junctions.join", "true"),
    ("tls.guess-signals", "true"),
    ("tls.discard-simple", "true"),
    ("tls.join", "true"),
    ("tls.default-type", "static"),
    ("sidewalks.guess", "true"),
    ("crossings.guess", "true"),
    ("remove-edges.isolated", "true"),
    ("keep-edges.by-vclass", "passenger"),
    ("output.street-names", "true"),
];

/// OpenDRIVE: lanes as they are drawn.
const OPENDRIVE: &[(&str, &str)] =
    &[("opendrive.curve-resolution", "1"), ("tls.guess-signals", "true"), ("tls.discard-simple", "true")];

fn write(path: &Path, contents: &[u8]) -> Result<(), NetError> {
    std::fs::write(path, contents).map_err(|source| NetError::Write { path: path.to_path_buf(), source })
}

/// A new folder, and the name of what is in it: the folder's.
fn folder(out: &Path) -> Result<String, NetError> {
    if out.exists() {
        return Err(NetError::Taken { path: out.to_path_buf() });
    }
    let unnamed = || NetError::Source { path: out.to_path_buf(), expected: "a folder with a name" };
    let name = out.file_name().and_then(|n| n.to_str()).ok_or_else(unnamed)?.to_string();
    std::fs::create_dir_all(out).map_err(|source| NetError::Write { path: out.to_path_buf(), source })?;
    Ok(name)
}

/// Checks the net and writes the configuration that names it.
fn finish(
    out: &Path,
    name: &str,
    net: PathBuf,
    polygons: Option<PathBuf>,
    warnings: Vec<String>,
) -> Result<Made, NetError> {
    Network::load(&net)?;
    let config = out.join(format!("{name}.sumocfg"));
    let name = quick_xml::escape::escape(name);
    let additional = polygons
        .as_ref()
        .map_or(String::new(), |_| format!("\n        <additional-files value=\"{name}.poly.xml\"/>"));
    let text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<sumoConfiguration>\n    <input>\n        \
         <net-file value=\"{name}.net.xml\"/>{additional}\n    </input>\n</sumoConfiguration>\n"
    );
    write(&config, text.as_bytes())?;
    Ok(Made { config, net, polygons, warnings })
}

/// Removes what was begun, where it failed.
fn or_clean<T>(out: &Path, made: Result<T, NetError>) -> Result<T, NetError> {
    if made.is_err() {
        let _ = std::fs::remove_dir_all(out);
    }
    made
}

/// Plain sources of a net: a `.netccfg`, or any of `X.nod.xml`, `X.edg.xml`, ... which brings the others that
/// begin with `X`.
const PLAIN: &str = "a .netccfg, or one of the plain files NAME.nod.xml and NAME.edg.xml";

/// Builds a net from plain sources into the new folder `out`.
///
/// # Errors
/// The sources are not plain XML or do not build.
pub fn build(source: &Path, out: &Path) -> Result<Made, NetError> {
    let install = SumoInstall::find()?;
    if !source.is_file() {
        return Err(NetError::Source { path: source.to_path_buf(), expected: PLAIN });
    }
    let text = source.to_string_lossy().to_string();
    let mut given: Vec<OsString> = Vec::new();
    if text.ends_with(".netccfg") {
        given.extend([OsString::from("-c"), source.into()]);
    } else {
        let kinds = [
            ("nod", "--node-files"),
            ("edg", "--edge-files"),
            ("con", "--connection-files"),
            ("tll", "--tllogic-files"),
            ("typ", "--type-files"),
        ];
        let stem = kinds.iter().find_map(|(kind, _)| text.strip_suffix(&format!(".{kind}.xml")));
        let Some(stem) = stem else {
            return Err(NetError::Source { path: source.to_path_buf(), expected: PLAIN });
        };
        for (kind, option) in kinds {
            let file = format!("{stem}.{kind}.xml");
            if Path::new(&file).is_file() {
                given.extend([OsString::from(option), file.into()]);
            }
        }
        given.extend(arguments(COMMON));
    }
    let name = folder(out)?;
    let net = out.join(format!("{name}.net.xml"));
    given.extend([
        OsString::from("--output-file"),
        std::path::absolute(&net).unwrap_or_else(|_| net.clone()).into(),
    ]);
    let made = run(&install, "netconvert", source, given)
        .and_then(|warnings| finish(out, &name, net, None, warnings));
    or_clean(out, made)
}

/// Imports OpenDRIVE (`.xodr`), OpenStreetMap (`.osm`, `.osm.xml`, `.osm.gz`) or a SUMO net (`.net.xml`, as
/// CARLA has them) into the new folder `out`; OpenStreetMap brings its buildings along.
///
/// # Errors
/// The file is none of these, or does not convert.
pub fn import(source: &Path, out: &Path) -> Result<Made, NetError> {
    let install = SumoInstall::find()?;
    let expected = "an OpenDRIVE file (.xodr), an OpenStreetMap file (.osm, .osm.xml, .osm.gz) or a SUMO net \
                    (.net.xml, .net.xml.gz); of an .osm.pbf make an .osm first: osmium cat X.osm.pbf -o X.osm";
    let not = || NetError::Source { path: source.to_path_buf(), expected };
    if !source.is_file() {
        return Err(not());
    }
    let lower = source.to_string_lossy().to_ascii_lowercase();
    let ends = |endings: &[&str]| endings.iter().any(|ending| lower.ends_with(ending));
    let osm = ends(&[".osm", ".osm.xml", ".osm.gz", ".osm.xml.gz"]);
    let (option, pairs) = if osm {
        ("--osm-files", OSM)
    } else if ends(&[".xodr"]) {
        ("--opendrive-files", OPENDRIVE)
    } else if ends(&[".net.xml", ".net.xml.gz"]) {
        ("--sumo-net-file", &[][..])
    } else {
        return Err(not());
    };
    let name = folder(out)?;
    let net = out.join(format!("{name}.net.xml"));
    let made = (|| {
        let mut given = vec![OsString::from(option), source.into()];
        if option == "--sumo-net-file" {
            // A SUMO net is copied unchanged: netconvert would compute its geometry again.
            write(&net, &read_bytes(source)?)?;
            return finish(out, &name, net.clone(), None, Vec::new());
        }
        given.extend(arguments(COMMON));
        given.extend(arguments(pairs));
        if osm {
            let types = install.home().join("data/typemap/osmNetconvert.typ.xml");
            given.extend([OsString::from("--type-files"), types.into()]);
        }
        given.extend([OsString::from("--output-file"), net.clone().into()]);
        let mut warnings = run(&install, "netconvert", source, given)?;
        let mut polygons = None;
        if osm {
            let file = out.join(format!("{name}.poly.xml"));
            warnings.extend(buildings(&install, source, &net, &file)?);
            polygons = Some(file);
        }
        finish(out, &name, net.clone(), polygons, warnings)
    })();
    or_clean(out, made)
}

/// OpenStreetMap's buildings, parks and waters as polygons of the net.
fn buildings(install: &SumoInstall, osm: &Path, net: &Path, file: &Path) -> Result<Vec<String>, NetError> {
    let types = install.home().join("data/typemap/osmPolyconvert.typ.xml");
    let given: Vec<OsString> = vec![
        "--osm-files".into(),
        osm.into(),
        "--net-file".into(),
        net.into(),
        "--type-file".into(),
        types.into(),
        "--osm.keep-full-type".into(),
        "true".into(),
        "--prune.in-net".into(),
        "true".into(),
        "--prune.in-net.offsets".into(),
        "100,100,100,100".into(),
        "--output-file".into(),
        file.into(),
    ];
    run(install, "polyconvert", osm, given)
}
