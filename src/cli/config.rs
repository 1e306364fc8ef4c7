//! What CONFIG on the command line means.

use super::Exit;
use std::path::{Path, PathBuf};
use wad_cosim::bundled;

/// The `.sumocfg` of a scenario's name or folder. A plain name is looked for in scenarios/ too.
pub fn resolve(name: &str) -> anyhow::Result<PathBuf> {
    let here = Path::new("scenarios").join(name);
    let name = if !Path::new(name).exists() && here.is_dir() {
        here.to_string_lossy().to_string()
    } else {
        name.to_string()
    };
    bundled::resolve(&name).map_err(|e| Exit::Input.because(e))
}
