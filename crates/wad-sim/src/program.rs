//! The program that uses these crates: its version, for what it writes.

use std::sync::OnceLock;

static VERSION: OnceLock<&'static str> = OnceLock::new();

/// Sets the program's version, e.g. `0.1.0 (a0cea15c2f)`. Only the first call has an effect.
pub fn set_version(version: &'static str) {
    let _ = VERSION.set(version);
}

/// The program's version; this crate's own if none was set.
pub fn version() -> &'static str {
    VERSION.get().copied().unwrap_or(env!("CARGO_PKG_VERSION"))
}
