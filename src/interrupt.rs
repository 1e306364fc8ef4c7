//! Ctrl-C and SIGTERM, as a flag for long work that looks at it now and then, and as a future.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;

/// A process's interruption by Ctrl-C or SIGTERM.
///
/// The first says so at once on stderr, whatever the process is busy with. A second one ends the process at
/// once with exit code 4.
#[derive(Clone, Debug)]
pub struct Interrupt {
    flag: Arc<AtomicBool>,
    raised: watch::Receiver<bool>,
}

impl Interrupt {
    /// Listens from now on.
    ///
    /// # Errors
    /// The system gives no signals or no thread.
    pub fn listen() -> io::Result<Self> {
        // One thread for the process, so that nothing is said twice.
        static LISTENING: Mutex<Option<Interrupt>> = Mutex::new(None);
        let mut listening = LISTENING.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(interrupt) = &*listening {
            return Ok(interrupt.clone());
        }
        let interrupt = Self::start()?;
        Ok(listening.insert(interrupt).clone())
    }

    fn start() -> io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        let (mut interrupt, mut terminate) = {
            let _inside = runtime.enter();
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
        };
        let (sender, raised) = watch::channel(false);
        let flag = Arc::new(AtomicBool::new(false));
        let shared = Arc::clone(&flag);
        std::thread::Builder::new().name("signals".to_string()).spawn(move || {
            runtime.block_on(async {
                loop {
                    tokio::select! {
                        _ = interrupt.recv() => {}
                        _ = terminate.recv() => {}
                    }
                    if shared.swap(true, Ordering::Relaxed) {
                        // SAFETY: ends the process. Not `exit`: it would run the destructors of libraries that other
                        // threads are using. SUMO and external agents end with us.
                        unsafe { libc::_exit(4) };
                    }
                    // `eprintln` would panic if stderr cannot be written.
                    let heard = "interrupted: ending as soon as the results are safe; once more ends at once";
                    let _ = writeln!(io::stderr(), "{heard}");
                    sender.send_replace(true);
                }
            });
        })?;
        Ok(Self { flag, raised })
    }

    /// Becomes true at the first signal.
    pub fn flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.flag)
    }

    /// Waits for the first signal.
    pub async fn wait(&mut self) {
        // An error means that the thread is gone, which it never is.
        let _ = self.raised.wait_for(|raised| *raised).await;
    }
}
