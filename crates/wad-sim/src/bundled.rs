//! The towns, scenarios and weights that travel with the program, and how a name on the command line becomes a file.
//!
//! The program hands its files over with [`register`], once, at its start: this crate holds none. If
//! nothing was registered (a test or an example of the workspace), the files beside the crates are read.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
pub use sumo_traci::cache::{cache_dir, cache_in};

/// Files by their path in the repository, e.g. `sumo_nets/town3/town3.sumocfg`.
type Files = BTreeMap<String, &'static [u8]>;

static FILES: OnceLock<Files> = OnceLock::new();

/// Folders of the repository that travel with the program.
pub const FOLDERS: [&str; 3] = ["sumo_nets", "scenarios", "models"];

/// Registers the files that travel with a program, by their path in the repository below one of [`FOLDERS`]. Only
/// the first call has an effect.
pub fn register(files: impl IntoIterator<Item = (String, &'static [u8])>) {
    let _ = FILES.set(files.into_iter().collect());
}

fn files() -> &'static Files {
    FILES.get_or_init(|| {
        let mut files = Files::new();
        let manifest = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from).unwrap_or_default();
        if let Some(root) = manifest.ancestors().find(|folder| folder.join("sumo_nets").is_dir()) {
            for folder in FOLDERS {
                read_folder(root, &root.join(folder), &mut files);
            }
        }
        files
    })
}

fn read_folder(root: &Path, folder: &Path, files: &mut Files) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            read_folder(root, &path, files);
        } else if let (Ok(name), Ok(bytes)) = (path.strip_prefix(root), std::fs::read(&path)) {
            files.insert(name.to_string_lossy().into_owned(), Vec::leak(bytes));
        }
    }
}

/// Names NAME for which the file `folder/NAME/NAME.sumocfg` is there, sorted.
fn configs(folder: &str) -> Vec<String> {
    let name = |path: &String| -> Option<String> {
        let (name, file) = path.strip_prefix(folder)?.strip_prefix('/')?.split_once('/')?;
        (file.strip_suffix(".sumocfg") == Some(name)).then(|| name.to_string())
    };
    files().keys().filter_map(name).collect()
}

/// Why a CONFIG argument does not name a file.
#[derive(Debug, thiserror::Error)]
pub enum ResolveError {
    /// Neither a file nor the name of a bundled town or scenario.
    #[error(
        "no such config: `{name}` is neither a file (.sumocfg, .net.xml, .net.xml.gz), nor a bundled town ({}), nor a bundled scenario ({})",
        bundled.join(", "),
        scenarios().join(", ")
    )]
    NotFound {
        /// The argument.
        name: String,
        /// The bundled towns.
        bundled: Vec<String>,
    },
    /// A folder with no `.sumocfg`, or with several.
    #[error("`{}` is a folder with {found} .sumocfg files; name the one to run", path.display())]
    AmbiguousFolder {
        /// The folder.
        path: PathBuf,
        /// How many it has.
        found: usize,
    },
    /// The bundled towns cannot be written to the cache.
    #[error("could not unpack the bundled towns into {}: {source}; check that the folder is writable and the disk has room", path.display())]
    Unpack {
        /// The cache's folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

/// Names of the bundled towns, sorted.
pub fn towns() -> Vec<String> {
    configs("sumo_nets")
}

/// Names of the bundled scenarios, sorted.
pub fn scenarios() -> Vec<String> {
    configs("scenarios")
}

/// The file of that path in the repository, e.g. `scenarios/curriculum.json`.
pub fn file(path: &str) -> Option<&'static [u8]> {
    files().get(path).copied()
}

/// Names of the bundled encoders (`models/encoder/NAME.safetensors`), sorted.
pub fn encoders() -> Vec<String> {
    let name =
        |path: &String| Some(path.strip_prefix("models/encoder/")?.strip_suffix(".safetensors")?.to_string());
    files().keys().filter_map(name).collect()
}

/// The bundled encoder of that name.
pub fn encoder(name: &str) -> Option<&'static [u8]> {
    file(&format!("models/encoder/{name}.safetensors"))
}

/// The bundled agent of that name, `wad-t` or `wad-s`.
pub fn agent(name: &str) -> Option<&'static [u8]> {
    match name {
        "wad-t" | "wad-s" => file(&format!("models/{}/agent.safetensors", name.replace('-', "_"))),
        _ => None,
    }
}

/// The bundled detector of that name (`models/detector/NAME.safetensors`).
pub fn detector(name: &str) -> Option<&'static [u8]> {
    file(&format!("models/detector/{name}.safetensors"))
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

/// Whether a file is a bundled one, unpacked in the cache.
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
    let wanted: Vec<(&String, &[u8])> = files()
        .iter()
        .filter(|(path, _)| path.starts_with("sumo_nets/") || path.starts_with("scenarios/"))
        .map(|(path, bytes)| (path, *bytes))
        .collect();
    let root = cache_dir().join("towns").join(format!("{:016x}", content_hash(&wanted)));
    if root.is_dir() {
        return Ok(root);
    }
    let fail = |source| ResolveError::Unpack { path: root.clone(), source };
    // Unpacked beside its place and moved there, so that a torn copy is never used and two
    // processes at once do not see each other's half.
    let staging = root.with_extension(format!("tmp{}", std::process::id()));
    let write = |(path, bytes): &(&String, &[u8])| {
        let path = staging.join(path);
        path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
        std::fs::write(path, bytes)
    };
    let written = std::fs::create_dir_all(&staging).and_then(|()| wanted.iter().try_for_each(write));
    if let Err(error) = written.and_then(|()| std::fs::rename(&staging, &root)) {
        let _ = std::fs::remove_dir_all(&staging);
        if !root.is_dir() {
            return Err(fail(error));
        }
    }
    Ok(root)
}

/// FNV-1a over the names and contents, in the order of the names.
fn content_hash(files: &[(&String, &[u8])]) -> u64 {
    let add = |hash: u64, bytes: &[u8]| {
        bytes.iter().fold(hash, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
    };
    files.iter().fold(0xcbf2_9ce4_8422_2325, |hash, (path, bytes)| add(add(hash, path.as_bytes()), bytes))
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
