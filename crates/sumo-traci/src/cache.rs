//! The cache folder in which `scripts/setup` of wad-cosim puts a SUMO.

use std::ffi::OsString;
use std::path::PathBuf;

/// The user's cache folder of this project: `$XDG_CACHE_HOME/wad-cosim` or `~/.cache/wad-cosim`; None where
/// neither is set.
pub fn cache_dir() -> Option<PathBuf> {
    cache_in(|name| std::env::var_os(name))
}

/// The same with these variables; None where neither names a folder. A relative `XDG_CACHE_HOME` is
/// ignored, as the XDG base directory specification asks.
pub fn cache_in(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let named = |name: &str| variable(name).map(PathBuf::from);
    let base = named("XDG_CACHE_HOME").filter(|path| path.is_absolute());
    let base =
        base.or_else(|| named("HOME").filter(|home| !home.as_os_str().is_empty()).map(|h| h.join(".cache")));
    Some(base?.join("wad-cosim"))
}
