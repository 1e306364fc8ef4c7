//! Free TCP ports, and which process listens on a port.

use std::io;
use std::net::{Ipv4Addr, TcpListener};

/// A port that was free a moment ago.
pub fn free() -> io::Result<u16> {
    Ok(TcpListener::bind((Ipv4Addr::UNSPECIFIED, 0))?.local_addr()?.port())
}

/// Whether process `pid` listens on TCP `port`.
///
/// Another process's listener does not count: with two launchers at work, the port that was free may
/// belong to the other launcher's SUMO by now.
#[cfg(target_os = "linux")]
pub fn is_listening(port: u16, pid: u32) -> bool {
    let inodes = socket_inodes(pid);
    if inodes.is_empty() {
        return false;
    }
    // The child's own network namespace is the one that counts.
    let table = std::fs::read_to_string(format!("/proc/{pid}/net/tcp")).unwrap_or_default();
    listeners(&table, port).any(|inode| inodes.contains(&inode))
}

/// Inodes of the sockets that a process has open.
#[cfg(target_os = "linux")]
fn socket_inodes(pid: u32) -> Vec<u64> {
    let Ok(files) = std::fs::read_dir(format!("/proc/{pid}/fd")) else { return Vec::new() };
    let inode = |entry: io::Result<std::fs::DirEntry>| {
        let target = std::fs::read_link(entry.ok()?.path()).ok()?;
        target.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.parse().ok()
    };
    files.filter_map(inode).collect()
}

/// Inodes of the sockets that listen on `port`, from the text of /proc/net/tcp.
#[cfg(target_os = "linux")]
fn listeners(table: &str, port: u16) -> impl Iterator<Item = u64> + '_ {
    const LISTEN: &str = "0A";
    let local = format!(":{port:04X}");
    table.lines().skip(1).filter_map(move |line| {
        let mut fields = line.split_whitespace();
        let (address, state) = (fields.nth(1)?, fields.nth(1)?);
        let inode = fields.nth(5)?.parse().ok()?;
        (address.ends_with(&local) && state == LISTEN).then_some(inode)
    })
}

/// Whether a process listens on TCP `port`, found by trying to bind it.
#[cfg(not(target_os = "linux"))]
pub fn is_listening(port: u16, _pid: u32) -> bool {
    TcpListener::bind((Ipv4Addr::UNSPECIFIED, port)).is_err()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_listener_is_seen_and_belongs_to_its_process() {
        let listener = TcpListener::bind((Ipv4Addr::UNSPECIFIED, 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        assert!(is_listening(port, std::process::id()));
        assert!(!is_listening(port, std::os::unix::process::parent_id()));
        drop(listener);
        assert!(!is_listening(port, std::process::id()));
    }
}
