//! CPU time, for figures that do not depend on what else the machine is doing. Linux only; None elsewhere.

/// CPU time of a process so far (s).
pub fn of_process(pid: u32) -> Option<f64> {
    // Nanoseconds on the CPU, nanoseconds waiting, time slices.
    let text = std::fs::read_to_string(format!("/proc/{pid}/schedstat")).ok()?;
    let nanoseconds: f64 = text.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

/// CPU time of this thread so far (s).
pub fn of_thread() -> Option<f64> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call writes one timespec through a pointer to a live one and keeps nothing.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    (status == 0).then_some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
}
