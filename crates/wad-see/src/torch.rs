//! How many threads libtorch computes with. It keeps the number per thread, so each that uses it says so.

use std::cell::Cell;

thread_local! {
    static CHOSEN: Cell<Option<i32>> = const { Cell::new(None) };
}

/// On this thread libtorch computes with `n` threads from here on.
pub fn threads(n: i32) {
    CHOSEN.set(Some(n.max(1)));
    tch::set_num_threads(n.max(1));
}

/// On this thread libtorch computes with one thread, unless [`threads`] said otherwise: our networks are small,
/// and many of them run beside each other. Whatever makes such a network calls this.
pub fn one_thread() {
    if CHOSEN.get().is_none() {
        threads(1);
    }
}
