//! Tells the linker where libtorch lies, and the binary which commit it was built from.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    version();
    link_libtorch();
}

/// Set `WAD_COSIM_VERSION` to the crate's version, with the commit where git knows it.
fn version() {
    let mut version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    // A crate unpacked inside someone else's repository must not take that one's commit.
    let own_repository =
        git(&["ls-files", "--error-unmatch", "build.rs"]).is_some() && Path::new(".git").exists();
    if own_repository && let Some(commit) = git(&["rev-parse", "--short=10", "HEAD"]) {
        version = format!("{version} ({commit})");
        // git appends to this file at every commit and checkout.
        if let Some(log) =
            git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|log| Path::new(log).exists())
        {
            println!("cargo:rerun-if-changed={log}");
        }
    }
    println!("cargo:rustc-env=WAD_COSIM_VERSION={version}");
}

/// What git answers, or None where git or the repository is missing.
fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

/// Let every binary, test and bench find libtorch without LD_LIBRARY_PATH.
fn link_libtorch() {
    // Set by torch-sys, thus only with the feature `learn`.
    let Ok(lib) = std::env::var("DEP_TCH_LIBTORCH_LIB") else { return };
    println!("cargo:rustc-link-arg=-Wl,-rpath,{lib}");
    // Nothing names a symbol of libtorch_cuda, so the linker would drop it, and with it the GPU.
    if Path::new(&lib).join("libtorch_cuda.so").exists() {
        println!("cargo:rustc-link-search=native={lib}");
        println!("cargo:rustc-link-arg=-Wl,--no-as-needed,-ltorch_cuda,--as-needed");
    }
}
