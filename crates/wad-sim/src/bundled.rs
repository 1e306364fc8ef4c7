//! The towns, scenarios and weights that travel with the program, and how a name on the command line becomes a file.
//!
//! The program hands its files over with [`register`], once, at its start: this crate holds none. If
//! nothing was registered (a test or an example of the workspace), the files beside the crates are read.

use crate::suggest;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};
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
        "no such config: `{name}` is neither a file (.sumocfg, .net.xml, .net.xml.gz), nor a bundled town ({}), nor a bundled scenario ({}){}",
        towns().join(", "),
        scenarios().join(", "),
        if near.is_empty() { String::new() } else { format!("; did you mean {}?", near.join(" or ")) }
    )]
    NotFound {
        /// The argument.
        name: String,
        /// The nearest names: files in the same folder, bundled towns and scenarios.
        near: Vec<String>,
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
    #[error(
        "could not unpack the bundled towns into {}: {source}; check that the folder is yours and writable, and the disk \
         has room, or name another with XDG_CACHE_HOME",
        path.display()
    )]
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

/// Names of the bundled agents (`models/wad_t/agent.safetensors` is `wad-t`), sorted.
pub fn agents() -> Vec<String> {
    let name = |path: &String| {
        Some(path.strip_prefix("models/")?.strip_suffix("/agent.safetensors")?.replace('_', "-"))
    };
    files().keys().filter_map(name).collect()
}

/// The bundled agent of that name.
pub fn agent(name: &str) -> Option<&'static [u8]> {
    let known = agents().iter().any(|agent| agent == name);
    known.then(|| file(&format!("models/{}/agent.safetensors", name.replace('-', "_"))))?
}

/// The bundled detector of that name (`models/detector/NAME.safetensors`).
pub fn detector(name: &str) -> Option<&'static [u8]> {
    file(&format!("models/detector/{name}.safetensors"))
}

/// The file that `name` means: a path that exists wins (a folder means the one .sumocfg in it),
/// then the bundled town of that name (`nets/town5.sumocfg`, `town5.sumocfg` and `town5` alike), then the
/// bundled scenario. Any other path that does not exist is an error: it meant another file.
///
/// # Errors
/// There is no such file, a folder has not one .sumocfg, or the bundled files cannot be unpacked.
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
    let file = name.strip_prefix("nets/").unwrap_or(name);
    let stem = stem(file);
    let folder = match (towns().iter().any(|town| town == stem), scenarios().iter().any(|s| s == stem)) {
        (true, _) => "sumo_nets",
        (_, true) if !is_net(file) => "scenarios",
        _ => return Err(ResolveError::NotFound { name: name.to_string(), near: near(path) }),
    };
    let folder = unpack()?.join(folder).join(stem);
    Ok(if is_net(file) { net_file(&folder, stem) } else { folder.join(format!("{stem}.sumocfg")) })
}

/// Endings of what a config may be.
const ENDINGS: [&str; 3] = [".sumocfg", ".net.xml.gz", ".net.xml"];

/// A file's name without the ending of a config.
fn stem(file: &str) -> &str {
    ENDINGS.iter().find_map(|ending| file.strip_suffix(ending)).unwrap_or(file)
}

fn is_net(file: &str) -> bool {
    ENDINGS[1..].iter().any(|ending| file.ends_with(ending))
}

/// Configs and folders beside a path that does not exist, then bundled names, that are nearest to it.
fn near(path: &Path) -> Vec<String> {
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let parent = path.parent().unwrap_or(Path::new(""));
    let folder = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
    let beside = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let beside = beside.filter(|path| {
        path.is_dir() || ENDINGS.iter().any(|ending| path.to_string_lossy().ends_with(ending))
    });
    let beside = beside.filter_map(|path| Some(path.file_name()?.to_str()?.to_string()));
    let mut beside: Vec<String> = beside.collect();
    beside.sort();
    let stems: Vec<&str> = beside.iter().map(|file| stem(file)).collect();
    let mut found: Vec<String> = Vec::new();
    for stem in suggest::near(stem(&file), stems.iter().copied()) {
        let named = beside.iter().zip(&stems).filter(|(_, other)| **other == stem);
        found.extend(named.map(|(file, _)| parent.join(file).display().to_string()));
    }
    let bundled: Vec<String> = towns().into_iter().chain(scenarios()).collect();
    found
        .extend(suggest::near(stem(&file), bundled.iter().map(String::as_str)).into_iter().map(String::from));
    found.dedup();
    found.truncate(3);
    found
}

/// Whether a file is a bundled one, unpacked in the cache.
pub fn is_unpacked(path: &Path) -> bool {
    caches().any(|cache| path.starts_with(cache))
}

/// Where the bundled files may be unpacked: in the user's cache, else in the system's folder for temporary files.
fn caches() -> impl Iterator<Item = PathBuf> {
    // SAFETY: geteuid only returns a number.
    let user = unsafe { libc::geteuid() };
    let temporary = std::env::temp_dir().join(format!("wad-cosim-{user}"));
    cache_dir().into_iter().chain([temporary]).map(|cache| cache.join("towns"))
}

fn net_file(town: &Path, stem: &str) -> PathBuf {
    let plain = town.join(format!("{stem}.net.xml"));
    if plain.is_file() { plain } else { town.join(format!("{stem}.net.xml.gz")) }
}

/// The folder with the bundled towns and scenarios, side by side as in the repository. Files in it that are
/// missing or changed are written again. It is in the user's cache; in the system's folder for temporary files
/// if that cannot be used.
///
/// # Errors
/// Neither can be written by this user alone.
pub fn unpack() -> Result<PathBuf, ResolveError> {
    static UNPACKED: Mutex<Option<PathBuf>> = Mutex::new(None);
    let mut unpacked = UNPACKED.lock().unwrap_or_else(PoisonError::into_inner);
    // Looked over once in a process, and again when the folder has gone.
    if let Some(root) = unpacked.as_ref().filter(|root| root.is_dir()) {
        return Ok(root.clone());
    }
    let mut failed = None;
    for cache in caches() {
        match unpack_in(&cache) {
            Ok(root) => return Ok(unpacked.insert(root).clone()),
            Err(source) => failed.get_or_insert(ResolveError::Unpack { path: cache, source }),
        };
    }
    let nowhere =
        || ResolveError::Unpack { path: PathBuf::new(), source: std::io::ErrorKind::NotFound.into() };
    Err(failed.unwrap_or_else(nowhere))
}

fn unpack_in(cache: &Path) -> std::io::Result<PathBuf> {
    let wanted: Vec<(&String, &[u8])> = files()
        .iter()
        .filter(|(path, _)| path.starts_with("sumo_nets/") || path.starts_with("scenarios/"))
        .map(|(path, bytes)| (path, *bytes))
        .collect();
    let root = cache.join(format!("{:016x}", content_hash(&wanted)));
    let paths: Vec<PathBuf> = wanted.iter().map(|(path, _)| root.join(path)).collect();
    let inside = |folder: &&Path| folder.starts_with(&root);
    // Parents first.
    let mut folders: BTreeSet<&Path> =
        paths.iter().flat_map(|path| path.ancestors().skip(1).take_while(inside)).collect();
    folders.extend([cache.parent().unwrap_or(cache), cache, &root]);
    for folder in folders {
        make_private(folder)?;
    }
    for ((_, bytes), path) in wanted.iter().zip(&paths) {
        let own = std::fs::symlink_metadata(path).is_ok_and(|found| found.is_file());
        if own && std::fs::read(path).is_ok_and(|found| found == *bytes) {
            continue;
        }
        // Written beside its place and moved there, so that another process never reads half a file.
        let mut draft = path.clone().into_os_string();
        draft.push(format!(".{}.tmp", std::process::id()));
        std::fs::write(&draft, bytes).and_then(|()| std::fs::rename(&draft, path))?;
    }
    Ok(root)
}

/// Makes a folder that only this user can write, or takes others' right to write from one that is there.
fn make_private(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    let found = std::fs::symlink_metadata(folder)?;
    // A link in a folder that others can write may be theirs.
    let link = found.is_symlink() && folder.starts_with(std::env::temp_dir());
    let found = std::fs::metadata(folder)?;
    // SAFETY: geteuid only returns a number.
    if link || found.uid() != unsafe { libc::geteuid() } {
        return Err(std::io::Error::other(format!("{} belongs to another user", folder.display())));
    }
    let mode = found.mode() & 0o7777;
    if mode & 0o022 == 0 {
        return Ok(());
    }
    std::fs::set_permissions(folder, std::fs::Permissions::from_mode(mode & !0o022))
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
    fn a_path_that_does_not_exist_is_not_the_bundled_town_of_its_file_name() {
        for name in ["bogus/dir/town5.sumocfg", "/home/me/fork/town5.net.xml", "other/cross", "nets/a/town5"]
        {
            let error = resolve(name).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("did you mean"), "{name}: {error}");
        }
        let error = resolve("twon5").unwrap_err().to_string();
        assert!(error.contains("did you mean town5"), "{error}");
    }

    #[test]
    fn the_nearest_files_beside_a_missing_one_are_named() {
        let dir = tempfile::tempdir().unwrap();
        for file in ["my_town.sumocfg", "my_town.net.xml", "notes.txt"] {
            std::fs::write(dir.path().join(file), "").unwrap();
        }
        let error = resolve(&dir.path().join("mytown.sumocfg").to_string_lossy()).unwrap_err().to_string();
        let meant = dir.path().join("my_town.sumocfg");
        assert!(error.contains(&format!("{}", meant.display())) && !error.contains("notes"), "{error}");
    }

    #[test]
    fn every_spelling_of_a_bundled_town_is_the_same_file() {
        let path = resolve("town5").unwrap();
        assert!(path.is_file());
        assert_eq!(resolve("nets/town5.sumocfg").unwrap(), path);
        assert_eq!(resolve("town5.sumocfg").unwrap(), path);
        assert!(resolve("town5.net.xml").unwrap().is_file());
    }

    #[test]
    fn a_changed_or_missing_bundled_file_is_written_again() {
        let dir = tempfile::tempdir().unwrap();
        let cache = dir.path().join("wad-cosim/towns");
        let root = unpack_in(&cache).unwrap();
        let (gone, changed) =
            (root.join("sumo_nets/town5/town5.sumocfg"), root.join("scenarios/cross/cross.rou.xml"));
        let before = std::fs::read(&changed).unwrap();
        std::fs::remove_file(&gone).unwrap();
        std::fs::write(&changed, "<routes/>").unwrap();
        assert_eq!(unpack_in(&cache).unwrap(), root);
        assert!(gone.is_file());
        assert_eq!(std::fs::read(&changed).unwrap(), before);
        let left = std::fs::read_dir(changed.parent().unwrap()).unwrap();
        assert!(left.flatten().all(|file| !file.path().to_string_lossy().ends_with(".tmp")));
    }

    #[test]
    fn a_cache_that_others_can_write_is_not_used_as_it_is() {
        use std::os::unix::fs::{MetadataExt, PermissionsExt};
        let dir = tempfile::tempdir().unwrap();
        let open = dir.path().join("open");
        std::fs::create_dir(&open).unwrap();
        std::fs::set_permissions(&open, std::fs::Permissions::from_mode(0o777)).unwrap();
        let cache = open.join("towns");
        let town = unpack_in(&cache).unwrap().join("sumo_nets/town5");
        std::fs::set_permissions(&town, std::fs::Permissions::from_mode(0o777)).unwrap();
        unpack_in(&cache).unwrap();
        for folder in town.ancestors().take(5) {
            assert_eq!(std::fs::metadata(folder).unwrap().mode() & 0o022, 0, "{}", folder.display());
        }
        // A link among temporary files may be anybody's.
        let link = dir.path().join("link");
        std::os::unix::fs::symlink(&open, &link).unwrap();
        assert!(make_private(&link).unwrap_err().to_string().contains("another user"));
    }
}
