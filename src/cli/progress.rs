//! A bar with rate and time left on a terminal; a plain line now and then elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use std::cell::Cell;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Progress of long work on stderr.
pub struct Bar {
    bar: Option<ProgressBar>,
    unit: &'static str,
    total: Cell<u64>,
    began: Instant,
    /// The count at the first display: work of an earlier call does not count for the rate.
    first: Cell<Option<u64>>,
    last: Cell<Option<Instant>>,
}

/// Time between plain lines.
const EVERY: Duration = Duration::from_secs(10);

impl Bar {
    /// Of `total` things called `unit`.
    pub fn new(total: u64, unit: &'static str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(total);
            let template = "{bar:30} {pos}/{len} {prefix}, {per_sec}, {eta} left  {msg}";
            let bar =
                ProgressStyle::with_template(template).map_or(bar.clone(), |style| bar.with_style(style));
            bar.with_prefix(unit)
        });
        Self {
            bar,
            unit,
            total: Cell::new(total),
            began: Instant::now(),
            first: Cell::new(None),
            last: Cell::new(None),
        }
    }

    /// Sets the total.
    pub fn set_total(&self, total: u64) {
        self.total.set(total);
        if let Some(bar) = &self.bar {
            bar.set_length(total);
        }
    }

    /// Prints a line above the bar.
    pub fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| super::note(text)),
            None => super::note(text),
        }
    }

    /// Shows that `done` are done.
    pub fn show(&self, done: u64, message: &str) {
        let first = self.first.get().unwrap_or(done);
        if self.first.replace(Some(first)).is_none()
            && let Some(bar) = &self.bar
        {
            bar.set_position(done);
            bar.reset_eta();
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            bar.set_message(message.to_string());
            return;
        }
        if self.last.get().is_some_and(|last| last.elapsed() < EVERY) {
            return;
        }
        self.last.set(Some(Instant::now()));
        let seconds = self.began.elapsed().as_secs_f64();
        let rate = done.saturating_sub(first) as f64 / seconds.max(1e-9);
        super::note(format_args!("{done}/{} {}, {rate:.1}/s  {message}", self.total.get(), self.unit));
    }

    /// Removes the bar.
    pub fn clear(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
