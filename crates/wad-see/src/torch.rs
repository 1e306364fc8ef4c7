//! libtorch's number of threads. It is set per calling thread, so each thread that uses libtorch sets it.

use std::cell::Cell;

thread_local! {
    static CHOSEN: Cell<Option<i32>> = const { Cell::new(None) };
}

/// Calls from this thread let libtorch compute with `n` threads from now on.
pub fn threads(n: i32) {
    CHOSEN.set(Some(n.max(1)));
    tch::set_num_threads(n.max(1));
}

/// Calls from this thread let libtorch compute with one thread, unless [`threads`] was called: our networks are
/// small, and many of them run beside each other. The code that makes such a network calls this.
pub fn one_thread() {
    if CHOSEN.get().is_none() {
        threads(1);
    }
}
