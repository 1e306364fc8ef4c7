//! SUMO as a child process: launch, free port, log file, post-mortem, and a guaranteed end.

use super::client::TcpClient;
use super::error::Error;
pub use super::install::{ANSWER, InstallError, OLDEST_SUMO, SumoInstall};
pub use super::post_mortem::PostMortem;
use super::{keeper, port};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Options that the launcher itself gives to SUMO.
const OWN_OPTIONS: [&str; 6] =
    ["remote-port", "num-clients", "configuration-file", "net-file", "seed", "step-length"];
/// How often a launch is tried again when another program took the port.
const PORT_ATTEMPTS: usize = 8;
const LOG_LINES: usize = 12;

/// What SUMO loads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A .sumocfg.
    Config(PathBuf),
    /// A .net.xml or .net.xml.gz.
    Net(PathBuf),
}

/// How to launch SUMO.
#[derive(Clone, Debug)]
pub struct LaunchOptions {
    /// The configuration or the network.
    pub input: Input,
    /// sumo-gui, playing at once and closing at the end, in place of sumo.
    pub gui: bool,
    /// SUMO's seed; None leaves it to the configuration.
    pub seed: Option<i64>,
    /// s; None leaves it to the configuration.
    pub step_length: Option<f64>,
    /// More options, without the dashes, in their long form: `("collision.action", Some("warn"))`.
    /// The last of equal names counts: SUMO refuses to start when an option is repeated.
    pub options: Vec<(String, Option<String>)>,
    /// Where SUMO runs; None for here.
    pub working_dir: Option<PathBuf>,
    /// Gets SUMO's stdout and stderr; overwritten. None for a temporary file that goes with the process.
    pub log_file: Option<PathBuf>,
    /// How long SUMO may take until it answers. It loads the network before; large ones take a while.
    pub startup_timeout: Duration,
}

impl LaunchOptions {
    /// Launches a configuration.
    pub fn config(path: impl Into<PathBuf>) -> Self {
        Self::new(Input::Config(path.into()))
    }

    /// Launches a network without demand.
    pub fn net(path: impl Into<PathBuf>) -> Self {
        Self::new(Input::Net(path.into()))
    }

    fn new(input: Input) -> Self {
        Self {
            input,
            gui: false,
            seed: None,
            step_length: None,
            options: Vec::new(),
            working_dir: None,
            log_file: None,
            startup_timeout: Duration::from_secs(120),
        }
    }

    /// With one more option.
    #[must_use]
    pub fn option(mut self, name: &str, value: impl ToString) -> Self {
        self.options.push((name.to_owned(), Some(value.to_string())));
        self
    }

    /// All arguments but the port.
    fn arguments(&self) -> Result<Vec<String>, LaunchError> {
        let (name, path) = match &self.input {
            Input::Config(path) => ("configuration-file", path),
            Input::Net(path) => ("net-file", path),
        };
        // A relative path is ours, not the working directory's.
        let path = std::path::absolute(path).map_err(LaunchError::Spawn)?;
        let mut options = vec![(name.to_owned(), Some(path.display().to_string()))];
        options.extend(self.seed.map(|seed| ("seed".to_owned(), Some(seed.to_string()))));
        options.extend(self.step_length.map(|s| ("step-length".to_owned(), Some(s.to_string()))));
        options.push(("no-step-log".to_owned(), Some("true".to_owned())));
        if self.gui {
            for name in ["start", "quit-on-end"] {
                options.push((name.to_owned(), Some("true".to_owned())));
            }
        }
        for (name, value) in &self.options {
            let name = name.trim_start_matches('-');
            if OWN_OPTIONS.contains(&name) {
                return Err(LaunchError::OwnOption(name.to_owned()));
            }
            match options.iter_mut().find(|(known, _)| known == name) {
                Some(option) => option.1.clone_from(value),
                None => options.push((name.to_owned(), value.clone())),
            }
        }
        let argument = |(name, value): (String, Option<String>)| [Some(format!("--{name}")), value];
        Ok(options.into_iter().flat_map(argument).flatten().collect())
    }
}

/// Why SUMO did not come up.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// No usable SUMO.
    #[error(transparent)]
    Install(#[from] InstallError),
    /// What it should load is not there.
    #[error("{} {what}: check the path", path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// An option that the launcher sets itself.
    #[error("SUMO's option --{0} is set by the launcher: use its own field in LaunchOptions")]
    OwnOption(String),
    /// The log file cannot be written.
    #[error("cannot write SUMO's log {}: {source}", path.display())]
    Log {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The program could not be started.
    #[error("cannot start SUMO: {0}")]
    Spawn(io::Error),
    /// It ended before it listened.
    #[error("SUMO did not start: {0}")]
    Exited(PostMortem),
    /// It neither listened nor ended.
    #[error("SUMO was not ready within {:.0} s; its log ends with\n{log}", limit.as_secs_f64())]
    Startup {
        /// The time limit.
        limit: Duration,
        /// The log's last lines.
        log: String,
    },
    /// It came up and does not speak TraCI as it should.
    #[error(transparent)]
    Traci(#[from] Error),
}

/// A SUMO of ours. Dropping it kills it; it dies with this process too, even by SIGKILL.
#[derive(Debug)]
pub struct SumoProcess {
    child: Child,
    log: File,
    log_file: Option<PathBuf>,
    port: u16,
}

impl SumoProcess {
    /// Finds a SUMO, launches it and connects.
    ///
    /// # Errors
    /// No usable SUMO, a wrong input or option (SUMO's own words are quoted), no TraCI.
    pub async fn launch(options: &LaunchOptions) -> Result<(Self, TcpClient), LaunchError> {
        let install = SumoInstall::find()?;
        install.check_version()?;
        Self::launch_with(&install, options).await
    }

    /// Launches this SUMO and connects.
    ///
    /// The listener is SUMO's, open to all of IPv4, for as long as it takes to connect: the only client
    /// is ours, and SUMO accepts no second one.
    ///
    /// # Errors
    /// As [`SumoProcess::launch`].
    pub async fn launch_with(
        install: &SumoInstall,
        options: &LaunchOptions,
    ) -> Result<(Self, TcpClient), LaunchError> {
        let (Input::Config(path) | Input::Net(path)) = &options.input;
        let unreadable = |what: String| LaunchError::Input { path: path.clone(), what };
        let found = std::fs::metadata(path).map_err(|e| unreadable(format!("cannot be read: {e}")))?;
        if !found.is_file() {
            return Err(unreadable("is not a file".to_owned()));
        }
        let arguments = options.arguments()?;
        let begin = Instant::now();
        for attempt in 1.. {
            let port = port::free().map_err(LaunchError::Spawn)?;
            let mut process = Self::spawn(install, options, &arguments, port)?;
            match process.wait_for_listener(begin, options.startup_timeout).await {
                Ok(()) => {
                    let left = options.startup_timeout.saturating_sub(begin.elapsed());
                    let client = TcpClient::attach_within(&format!("127.0.0.1:{port}"), left).await;
                    let error = match client {
                        Ok(client) => return Ok((process, client)),
                        Err(error) => process.explain(error).await,
                    };
                    // It listens before it loads: what it cannot load shows here.
                    return Err(match error {
                        Error::Died { post_mortem, .. } => LaunchError::Exited(post_mortem),
                        Error::Timeout { .. } => {
                            LaunchError::Startup { limit: options.startup_timeout, log: process.log_tail() }
                        }
                        error => error.into(),
                    });
                }
                Err(LaunchError::Exited(end))
                    if end.log.contains("Address already in use") && attempt < PORT_ATTEMPTS => {}
                Err(error) => return Err(error),
            }
        }
        unreachable!("the loop returns at its last attempt")
    }

    fn spawn(
        install: &SumoInstall,
        options: &LaunchOptions,
        arguments: &[String],
        port: u16,
    ) -> Result<Self, LaunchError> {
        let log_error = |path: &Path, source| LaunchError::Log { path: path.to_owned(), source };
        let log = match &options.log_file {
            Some(path) => File::options()
                .read(true)
                .write(true)
                .create(true)
                .truncate(true)
                .open(path)
                .map_err(|e| log_error(path, e))?,
            None => unnamed_file().map_err(|e| log_error(&std::env::temp_dir(), e))?,
        };
        let mut command = install.command(if options.gui { "sumo-gui" } else { "sumo" });
        command.args(arguments).args(["--num-clients", "1", "--remote-port", &port.to_string()]);
        if let Some(folder) = &options.working_dir {
            command.current_dir(folder);
        }
        let out = log.try_clone().and_then(|out| Ok((out, log.try_clone()?)));
        let (out, err) = out.map_err(LaunchError::Spawn)?;
        command.stdout(Stdio::from(out)).stderr(Stdio::from(err));
        // A Ctrl-C in the terminal is for this process, which then closes SUMO between two messages.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        tracing::debug!(?command, "launching SUMO");
        let child = keeper::spawn(command, libc::SIGKILL).map_err(LaunchError::Spawn)?;
        Ok(Self { child, log, log_file: options.log_file.clone(), port })
    }

    async fn wait_for_listener(&mut self, begin: Instant, limit: Duration) -> Result<(), LaunchError> {
        let mut pause = Duration::from_millis(2);
        loop {
            if let Ok(Some(_)) = self.child.try_wait() {
                return Err(LaunchError::Exited(self.post_mortem()));
            }
            if port::is_listening(self.port, self.child.id()) {
                return Ok(());
            }
            if begin.elapsed() > limit {
                return Err(LaunchError::Startup { limit, log: self.log_tail() });
            }
            tokio::time::sleep(pause).await;
            pause = (pause * 5 / 4).min(Duration::from_millis(50));
        }
    }

    /// The process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// The TCP port that it was given.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// The last lines of its log.
    pub fn log_tail(&self) -> String {
        tail(&self.log).unwrap_or_else(|e| format!("(the log cannot be read: {e})"))
    }

    /// How it ended, or that it still runs.
    pub fn post_mortem(&mut self) -> PostMortem {
        let status = self.child.try_wait().ok().flatten();
        PostMortem { status, log: self.log_tail(), log_file: self.log_file.clone() }
    }

    /// Says of a client's error what this process has to do with it: when it is dead, or dies within a
    /// second, the error becomes [`Error::Died`] with its exit status and last log lines.
    pub async fn explain(&mut self, error: Error) -> Error {
        if !matches!(error, Error::Closed { .. } | Error::Timeout { .. } | Error::Protocol { .. }) {
            return error;
        }
        // A process that closed its socket is about to end.
        let patience = if matches!(error, Error::Closed { .. }) { 1000 } else { 0 };
        match self.wait_at_most(Duration::from_millis(patience)).await {
            Some(_) => Error::Died { post_mortem: self.post_mortem(), source: Box::new(error) },
            None => error,
        }
    }

    /// Waits for its end, for example after [`super::Client::close`]; None when it still runs after `limit`.
    pub async fn wait_at_most(&mut self, limit: Duration) -> Option<ExitStatus> {
        let begin = Instant::now();
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Some(status),
                Err(_) => return None,
                Ok(None) if begin.elapsed() >= limit => return None,
                Ok(None) => tokio::time::sleep(Duration::from_millis(5)).await,
            }
        }
    }

    /// Kills it at once and waits until it is gone.
    pub fn kill(&mut self) {
        // Both fail only where it is gone already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for SumoProcess {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A file without a name: it goes with its last handle.
fn unnamed_file() -> io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt;
    static NUMBER: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    let path = std::env::temp_dir().join(format!("wad-cosim-sumo-{}-{number}.log", std::process::id()));
    let file = File::options().read(true).write(true).create_new(true).mode(0o600).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}

/// The last lines of a log, without touching the position at which SUMO writes.
fn tail(log: &File) -> io::Result<String> {
    use std::os::unix::fs::FileExt;
    let length = log.metadata()?.len();
    let mut bytes = vec![0; length.min(8192) as usize];
    let from = length - bytes.len() as u64;
    let read = log.read_at(&mut bytes, from)?;
    bytes.truncate(read);
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text.lines().map(str::trim_end).filter(|line| !line.is_empty()).collect();
    Ok(lines[lines.len().saturating_sub(LOG_LINES)..].join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_option_is_repeated_and_the_last_one_counts() {
        let mut options = LaunchOptions::config("/a/b.sumocfg").option("no-step-log", "false");
        options = options.option("--collision.action", "warn").option("collision.action", "none");
        options.seed = Some(7);
        let arguments = options.arguments().unwrap();
        let expected = [
            "--configuration-file",
            "/a/b.sumocfg",
            "--seed",
            "7",
            "--no-step-log",
            "false",
            "--collision.action",
            "none",
        ];
        assert_eq!(arguments, expected);
    }

    #[test]
    fn an_option_of_the_launchers_own_is_refused() {
        let error = LaunchOptions::net("x.net.xml").option("remote-port", 1).arguments().unwrap_err();
        assert!(error.to_string().contains("--remote-port"), "{error}");
    }

    #[test]
    fn the_tail_is_the_last_lines() {
        use std::io::Write;
        let mut file = unnamed_file().unwrap();
        for i in 0..100 {
            writeln!(file, "line {i}\n").unwrap();
        }
        let tail = tail(&file).unwrap();
        assert_eq!(tail.lines().count(), LOG_LINES);
        assert!(tail.starts_with("line 88\n") && tail.ends_with("line 99"), "{tail}");
    }
}
