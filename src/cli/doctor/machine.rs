//! The machine itself: GPU, cores, memory, and the folder that wad-cosim writes to.

use super::Finding;
use std::process::{Command, Stdio};
use wad_cosim::bundled;

/// Whether libtorch can use a GPU, or misses one that is there.
pub fn gpu() -> Finding {
    let card = nvidia_card();
    let name = card.as_deref().unwrap_or("a GPU");
    match usable_gpus() {
        0 if card.is_some() => {
            Finding::optional("GPU", format!("{name} is here, but libtorch does not use it"))
                .advice("point LIBTORCH to a CUDA build of libtorch and build again (docs/install.md)")
        }
        0 => Finding::optional("GPU", "none; everything runs on the CPU"),
        count => Finding::ok("GPU", format!("{name}; libtorch can use {count}")),
    }
}

#[cfg(feature = "learn")]
fn usable_gpus() -> i64 {
    if tch::Cuda::is_available() { tch::Cuda::device_count() } else { 0 }
}

#[cfg(not(feature = "learn"))]
fn usable_gpus() -> i64 {
    0
}

/// The first NVIDIA card's name and memory, by its driver's own tool.
fn nvidia_card() -> Option<String> {
    // The tool can take minutes on a machine whose driver is not loaded.
    std::fs::metadata("/proc/driver/nvidia/version").ok()?;
    let output = Command::new("nvidia-smi")
        .args(["--query-gpu=name,memory.total", "--format=csv,noheader"])
        .stdin(Stdio::null())
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    output.status.success().then(|| text.lines().next().map(str::to_owned))?
}

/// Cores that this process may use: affinity and container limits count.
pub fn cores() -> Finding {
    match std::thread::available_parallelism() {
        Ok(cores) => Finding::ok("cores", cores.to_string()),
        Err(error) => Finding::optional("cores", format!("unknown: {error}")),
    }
}

/// Memory that a run with dense traffic and its SUMO need at most, with a margin (MiB).
const ENOUGH_MEMORY: u64 = 1024;

pub fn memory() -> Finding {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    match (meminfo(&text, "MemTotal:"), meminfo(&text, "MemAvailable:")) {
        (Some(total), Some(free)) => {
            let found = format!("{:.1} GiB, {:.1} GiB free", total as f64 / 1024.0, free as f64 / 1024.0);
            if free < ENOUGH_MEMORY {
                Finding::optional("memory", found)
                    .advice("little is free: close other programs, or run with less traffic")
            } else {
                Finding::ok("memory", found)
            }
        }
        _ => Finding::optional("memory", "unknown: /proc/meminfo cannot be read"),
    }
}

/// The folder that the bundled towns are unpacked into.
pub fn cache() -> Finding {
    match bundled::unpack() {
        Ok(folder) => Finding::ok("cache", folder.display().to_string()),
        Err(error) => Finding::missing("cache", error.to_string()),
    }
}

/// The towns inside this binary.
pub fn towns() -> Finding {
    Finding::ok("towns", bundled::towns().join(", "))
}

/// A field of /proc/meminfo (MiB).
fn meminfo(text: &str, field: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(field))?;
    Some(line.trim().strip_suffix(" kB")?.parse::<u64>().ok()? / 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meminfo_is_read_in_mib() {
        let text = "MemTotal:       25179452 kB\nMemFree:        1000 kB\nMemAvailable:    2048 kB\n";
        assert_eq!(meminfo(text, "MemAvailable:"), Some(2));
        assert_eq!(meminfo(text, "SwapTotal:"), None);
    }
}
