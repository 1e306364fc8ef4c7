//! The files that travel with the program: towns, scenarios, weights.

use include_dir::{Dir, include_dir};

static TOWNS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/sumo_nets");
static SCENARIOS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/scenarios");
static MODELS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/models");

/// Makes the bundled towns, scenarios and weights known to [`crate::bundled`], and the version to [`crate::program`]. A program that uses this library calls
/// it once, at its start.
pub fn register() {
    let mut files = Vec::new();
    for (folder, dir) in [("sumo_nets", &TOWNS), ("scenarios", &SCENARIOS), ("models", &MODELS)] {
        collect(folder, dir, &mut files);
    }
    crate::bundled::register(files);
    crate::program::set_version(env!("WAD_COSIM_VERSION"));
}

fn collect(folder: &str, dir: &Dir<'static>, files: &mut Vec<(String, &'static [u8])>) {
    for file in dir.files() {
        files.push((format!("{folder}/{}", file.path().display()), file.contents()));
    }
    for inner in dir.dirs() {
        collect(folder, inner, files);
    }
}
