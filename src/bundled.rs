//! The towns and scenarios that travel with the binary, and how a name on the command line becomes a file.

use include_dir::{Dir, DirEntry, include_dir};
use std::path::{Path, PathBuf};
pub use sumo_traci::cache::{cache_dir, cache_in};

static TOWNS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/sumo_nets");
static SCENARIOS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/scenarios");
static ENCODERS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/models/encoder");
static WAD_T: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/models/wad_t");
static WAD_S: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/models/wad_s");
static DETECTORS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/models/detector");

/// Why a CONFIG argument does not name a file.
#[derive(Debug, thiserror::Error)]
pub enum ResolveError {
    #[error(
        "no such config: `{name}` is neither a file (.sumocfg, .net.xml, .net.xml.gz), nor a bundled town ({}), nor a bundled scenario ({})",
        bundled.join(", "),
        scenarios().join(", ")
    )]
    NotFound { name: String, bundled: Vec<String> },
    #[error("`{}` is a folder with {found} .sumocfg files; name the one to run", path.display())]
    AmbiguousFolder { path: PathBuf, found: usize },
    #[error("could not unpack the bundled towns into {}: {source}; check that the folder is writable and the disk has room", path.display())]
    Unpack { path: PathBuf, source: std::io::Error },
}

/// Names of the bundled towns, sorted.
pub fn towns() -> Vec<String> {
    let mut names: Vec<String> = TOWNS
        .dirs()
        .filter_map(|dir| dir.path().file_name()?.to_str().map(String::from))
        .filter(|name| TOWNS.get_file(format!("{name}/{name}.sumocfg")).is_some())
        .collect();
    names.sort();
    names
}

/// Names of the bundled scenarios, sorted.
pub fn scenarios() -> Vec<String> {
    let mut names: Vec<String> = SCENARIOS
        .dirs()
        .filter_map(|dir| dir.path().file_name()?.to_str().map(String::from))
        .filter(|name| SCENARIOS.get_file(format!("{name}/{name}.sumocfg")).is_some())
        .collect();
    names.sort();
    names
}

/// Names of the bundled encoders (`models/encoder/NAME.safetensors`), sorted.
pub fn encoders() -> Vec<String> {
    let mut names: Vec<String> = ENCODERS
        .files()
        .filter_map(|file| Some(file.path().to_str()?.strip_suffix(".safetensors")?.to_string()))
        .collect();
    names.sort();
    names
}

/// The bundled encoder of that name.
pub fn encoder(name: &str) -> Option<&'static [u8]> {
    ENCODERS.get_file(format!("{name}.safetensors")).map(|file| file.contents())
}

/// The bundled agent of that name, `wad-t` or `wad-s`.
pub fn agent(name: &str) -> Option<&'static [u8]> {
    let folder = match name {
        "wad-t" => &WAD_T,
        "wad-s" => &WAD_S,
        _ => return None,
    };
    folder.get_file("agent.safetensors").map(|file| file.contents())
}

/// The bundled detector of that name (`models/detector/NAME.safetensors`).
pub fn detector(name: &str) -> Option<&'static [u8]> {
    DETECTORS.get_file(format!("{name}.safetensors")).map(|file| file.contents())
}

/// The file that `name` means: a path that exists wins (a folder means the one .sumocfg in it),
/// then the bundled town of that file name (`nets/town5.sumocfg`, `town5.sumocfg` and `town5` alike), then
/// the bundled scenario.
pub fn resolve(name: &str) -> Result<PathBuf, ResolveError> {
    let path = Path::new(name);
    if path.is_file() {
        return Ok(path.to_path_buf());
    }
    if path.is_dir() {
        let mut configs: Vec<PathBuf> = std::fs::read_dir(path)
            .into_iter()
            .flatten()
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|p| p.extension().is_some_and(|e| e == "sumocfg"))
            .collect();
        return match configs.len() {
            1 => Ok(configs.remove(0)),
            found => Err(ResolveError::AmbiguousFolder { path: path.to_path_buf(), found }),
        };
    }
    let file = path.file_name().and_then(|f| f.to_str()).unwrap_or(name);
    let stem = [".sumocfg", ".net.xml.gz", ".net.xml"]
        .iter()
        .find_map(|suffix| file.strip_suffix(suffix))
        .unwrap_or(file);
    let bundled = towns();
    if !bundled.iter().any(|town| town == stem) {
        if scenarios().iter().any(|scenario| scenario == stem) {
            return Ok(unpack()?.join("scenarios").join(stem).join(format!("{stem}.sumocfg")));
        }
        return Err(ResolveError::NotFound { name: name.to_string(), bundled });
    }
    let root = unpack()?.join("sumo_nets");
    let net_only = file.ends_with(".net.xml") || file.ends_with(".net.xml.gz");
    let town = root.join(stem);
    Ok(if net_only { net_file(&town, stem) } else { town.join(format!("{stem}.sumocfg")) })
}

/// Whether a file is one of the bundled ones, as they lie unpacked in the cache.
pub fn is_unpacked(path: &Path) -> bool {
    path.starts_with(cache_dir().join("towns"))
}

fn net_file(town: &Path, stem: &str) -> PathBuf {
    let plain = town.join(format!("{stem}.net.xml"));
    if plain.is_file() { plain } else { town.join(format!("{stem}.net.xml.gz")) }
}

/// Writes the bundled towns and scenarios into the cache once per content, side by side as in the
/// repository, and returns the folder.
fn unpack() -> Result<PathBuf, ResolveError> {
    let root = cache_dir().join("towns").join(format!("{:016x}", content_hash(&[&TOWNS, &SCENARIOS])));
    if root.is_dir() {
        return Ok(root);
    }
    let fail = |source| ResolveError::Unpack { path: root.clone(), source };
    // Unpacked beside its place and moved there, so that a torn copy is never used and two
    // processes at once do not see each other's half.
    let staging = root.with_extension(format!("tmp{}", std::process::id()));
    let (towns, scenarios) = (staging.join("sumo_nets"), staging.join("scenarios"));
    std::fs::create_dir_all(&towns).map_err(fail)?;
    std::fs::create_dir_all(&scenarios).map_err(fail)?;
    let moved = TOWNS
        .extract(&towns)
        .and_then(|()| SCENARIOS.extract(&scenarios))
        .and_then(|()| std::fs::rename(&staging, &root));
    if let Err(error) = moved {
        let _ = std::fs::remove_dir_all(&staging);
        if !root.is_dir() {
            return Err(fail(error));
        }
    }
    Ok(root)
}

/// FNV-1a over the names and contents, in a fixed order.
fn content_hash(dirs: &[&Dir<'_>]) -> u64 {
    fn add(hash: u64, bytes: &[u8]) -> u64 {
        bytes.iter().fold(hash, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
    }
    fn walk(mut hash: u64, dir: &Dir<'_>) -> u64 {
        let mut entries: Vec<&DirEntry<'_>> = dir.entries().iter().collect();
        entries.sort_by_key(|entry| entry.path());
        for entry in entries {
            hash = add(hash, entry.path().to_string_lossy().as_bytes());
            hash = match entry {
                DirEntry::Dir(dir) => walk(hash, dir),
                DirEntry::File(file) => add(hash, file.contents()),
            };
        }
        hash
    }
    dirs.iter().fold(0xcbf2_9ce4_8422_2325, |hash, dir| walk(hash, dir))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_name_lists_the_bundled_towns() {
        let error = resolve("nets/atlantis.sumocfg").unwrap_err().to_string();
        assert!(error.contains("atlantis") && error.contains("town5"), "{error}");
    }

    #[test]
    fn every_spelling_of_a_bundled_town_is_the_same_file() {
        let path = resolve("town5").unwrap();
        assert!(path.is_file());
        assert_eq!(resolve("nets/town5.sumocfg").unwrap(), path);
        assert_eq!(resolve("town5.sumocfg").unwrap(), path);
        assert!(resolve("town5.net.xml").unwrap().is_file());
    }
}
