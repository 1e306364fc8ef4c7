//! Children that do not outlive this process, even if it is killed.

use std::io::{self, Read};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, mpsc};
use std::time::{Duration, Instant};

/// Starts a command so that the kernel sends it `signal` (such as `libc::SIGKILL`) when this process ends,
/// however it ends. On Linux only; elsewhere it is started as usual.
///
/// The kernel sends the signal when the *thread* that started the child ends. So one thread, which
/// lives as long as the process, starts them all.
///
/// # Errors
/// As [`Command::spawn`], and the thread cannot be started.
pub fn spawn(command: Command, signal: i32) -> io::Result<Child> {
    type Request = (Command, i32, mpsc::Sender<io::Result<Child>>);
    /// The thread's process and its requests: a fork copies this and not the thread.
    static KEEPER: Mutex<Option<(u32, mpsc::Sender<Request>)>> = Mutex::new(None);
    let start = || {
        let (sender, requests) = mpsc::channel::<Request>();
        let keep = move || {
            for (mut command, signal, answer) in requests {
                end_with_us(&mut command, signal);
                // A requester that is gone has dropped its receiver; the child then goes with the answer.
                if let Err(mpsc::SendError(Ok(mut child))) = answer.send(command.spawn()) {
                    let _ = child.kill();
                    let _ = child.wait();
                }
            }
        };
        std::thread::Builder::new().name("child-keeper".to_owned()).spawn(keep).map(|_| sender)
    };
    let gone = || io::Error::other("the thread that starts other programs could not be started");
    let (sender, answer) = mpsc::channel();
    let own = std::process::id();
    let mut keeper = KEEPER.lock().map_err(|_| gone())?;
    let requests = match keeper.take() {
        Some((process, requests)) if process == own => requests,
        _ => start()?,
    };
    let sent = requests.send((command, signal, sender)).map_err(|_| gone());
    *keeper = Some((own, requests));
    drop(keeper);
    sent?;
    answer.recv().map_err(|_| gone())?
}

/// What a command prints, if it ends within `limit`; else it is killed.
///
/// # Errors
/// It cannot be started, or took too long.
pub fn output_within(mut command: Command, limit: Duration) -> io::Result<Output> {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let begin = Instant::now();
    let mut child = spawn(command, libc::SIGKILL)?;
    let (stdout, stderr) = (read(child.stdout.take()), read(child.stderr.take()));
    let mut pause = Duration::from_millis(1);
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if begin.elapsed() > limit {
            // Both fail only where it is gone already.
            let _ = child.kill();
            let _ = child.wait();
            let text = format!("it did not end within {:.0} s", limit.as_secs_f64());
            return Err(io::Error::new(io::ErrorKind::TimedOut, text));
        }
        std::thread::sleep(pause);
        pause = (pause * 5 / 4).min(Duration::from_millis(20));
    };
    // A child of its own may keep its pipes open.
    let left = || limit.saturating_sub(begin.elapsed()).max(Duration::from_secs(1));
    let late = |_| io::Error::new(io::ErrorKind::TimedOut, "it ended, and its output did not");
    let (stdout, stderr) =
        (stdout.recv_timeout(left()).map_err(late)?, stderr.recv_timeout(left()).map_err(late)?);
    Ok(Output { status, stdout, stderr })
}

/// Reads a pipe to its end on a thread of its own.
fn read(pipe: Option<impl Read + Send + 'static>) -> mpsc::Receiver<Vec<u8>> {
    let (sender, bytes) = mpsc::channel();
    if let Some(mut pipe) = pipe {
        std::thread::spawn(move || {
            let mut all = Vec::new();
            // What came before an error is still worth showing.
            let _ = pipe.read_to_end(&mut all);
            let _ = sender.send(all);
        });
    }
    bytes
}

#[cfg(target_os = "linux")]
fn end_with_us(command: &mut Command, signal: i32) {
    use std::os::unix::process::CommandExt;
    let parent = std::process::id();
    let before_exec = move || {
        // SAFETY: prctl and getppid are async-signal-safe and touch no memory of ours.
        let (refused, now) = unsafe {
            let refused = libc::prctl(libc::PR_SET_PDEATHSIG, signal) != 0;
            (refused, libc::getppid())
        };
        if refused {
            return Err(io::Error::last_os_error());
        }
        // We may have died before the request for the signal was in place.
        if now as u32 != parent {
            return Err(io::Error::from_raw_os_error(libc::ESRCH));
        }
        Ok(())
    };
    // SAFETY: the closure runs between fork and exec, and allocates nothing.
    unsafe { command.pre_exec(before_exec) };
}

#[cfg(not(target_os = "linux"))]
fn end_with_us(_command: &mut Command, _signal: i32) {}

#[cfg(test)]
mod tests {
    use super::*;

    fn sh(script: &str) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        command
    }

    #[test]
    fn a_program_that_hangs_is_ended() {
        let error = output_within(sh("sleep 1000"), Duration::from_millis(100)).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        // More than a pipe holds, on both.
        let script = "head -c 300000 /dev/zero; head -c 300000 /dev/zero >&2; exit 3";
        let output = output_within(sh(script), Duration::from_secs(60)).unwrap();
        assert_eq!((output.stdout.len(), output.stderr.len()), (300_000, 300_000));
        assert_eq!(output.status.code(), Some(3));
    }
}
