//! Finding a SUMO on this machine.

use super::keeper;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, OnceLock};
use std::time::Duration;

/// The oldest SUMO release that is good enough.
pub const OLDEST_SUMO: (u32, u32, u32) = (1, 28, 0);

/// Why there is no usable SUMO.
#[derive(Debug, thiserror::Error)]
pub enum InstallError {
    /// No SUMO anywhere.
    #[error(
        "no SUMO found; looked at {}. Run scripts/setup, or set WAD_COSIM_SUMO_HOME or SUMO_HOME to a SUMO 1.28.0",
        looked.join(", ")
    )]
    NotFound {
        /// Every place, in order.
        looked: Vec<String>,
    },
    /// It is there and does not run.
    #[error("{} does not run: {why}. Run scripts/setup to install SUMO 1.28.0 and the system packages it needs", program.display())]
    Broken {
        /// SUMO's program.
        program: PathBuf,
        /// Its output, or why it did not start.
        why: String,
    },
    /// It is too old.
    #[error("{} is SUMO {found}, and {}.{}.{} or newer is needed: run scripts/setup", program.display(), needed.0, needed.1, needed.2)]
    TooOld {
        /// SUMO's program.
        program: PathBuf,
        /// Its version.
        found: String,
        /// The oldest version that is good enough.
        needed: (u32, u32, u32),
    },
}

/// How long a SUMO may take to say its version or its options.
pub const ANSWER: Duration = Duration::from_secs(30);

/// The SUMO that came with the program.
static OWN: OnceLock<PathBuf> = OnceLock::new();

/// A SUMO on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SumoInstall {
    home: PathBuf,
}

impl SumoInstall {
    /// The first SUMO found: at `WAD_COSIM_SUMO_HOME`, the program's own ([`SumoInstall::set_own`]), in the
    /// cache folder that scripts/setup fills, at `SUMO_HOME`, next to a `sumo` on the PATH.
    ///
    /// # Errors
    /// There is none, or none at `WAD_COSIM_SUMO_HOME` where that is set: nothing else is tried then.
    pub fn find() -> Result<Self, InstallError> {
        Self::find_with(|name| std::env::var_os(name).filter(|value| !value.is_empty()))
    }

    /// Names the home folder of a SUMO that came with the program, such as a Python package that the program
    /// depends on. Only the first call has an effect.
    pub fn set_own(home: PathBuf) {
        let _ = OWN.set(home);
    }

    fn find_with(variable: impl Fn(&str) -> Option<OsString>) -> Result<Self, InstallError> {
        let mut looked = Vec::new();
        let mut candidate = |home: PathBuf, label: &str| {
            let found = home.join("bin/sumo").is_file();
            looked.push(format!("{label} ({})", home.display()));
            found.then_some(Self { home })
        };
        if let Some(home) = variable("WAD_COSIM_SUMO_HOME") {
            // If it is set, nothing else is tried.
            let found = candidate(home.into(), "WAD_COSIM_SUMO_HOME");
            return found.ok_or(InstallError::NotFound { looked });
        }
        if let Some(install) = OWN.get().and_then(|home| candidate(home.clone(), "the program's own")) {
            return Ok(install);
        }
        let cached = crate::cache::cache_in(&variable).map(|cache| cache.join("sumo-1.28.0/sumo"));
        if let Some(install) = cached.and_then(|home| candidate(home, "the cache folder")) {
            return Ok(install);
        }
        let home = variable("SUMO_HOME").map(PathBuf::from);
        if let Some(install) = home.and_then(|home| candidate(home, "SUMO_HOME")) {
            return Ok(install);
        }
        let path = variable("PATH").unwrap_or_default();
        for folder in std::env::split_paths(&path) {
            if let Some(home) = home_of(&folder.join("sumo")) {
                return Ok(Self { home });
            }
        }
        looked.push("the PATH".to_owned());
        Err(InstallError::NotFound { looked })
    }

    /// A SUMO at a known home folder (the one with `bin`, `tools` and `data`).
    pub fn at(home: impl Into<PathBuf>) -> Self {
        Self { home: home.into() }
    }

    /// The home folder, SUMO's own SUMO_HOME.
    pub fn home(&self) -> &Path {
        &self.home
    }

    /// A program of it: "sumo", "sumo-gui", "netconvert", "netgenerate", "netedit", "duarouter", ...
    pub fn program(&self, name: &str) -> PathBuf {
        self.home.join("bin").join(name)
    }

    /// A command that runs one of its programs with SUMO_HOME set and no standard input.
    pub fn command(&self, name: &str) -> Command {
        let mut command = Command::new(self.program(name));
        command.env("SUMO_HOME", &self.home).stdin(Stdio::null());
        command
    }

    /// Its version, as `sumo --version` says it.
    ///
    /// # Errors
    /// It does not run, or says no version.
    pub fn version(&self) -> Result<(u32, u32, u32), InstallError> {
        let program = self.program("sumo");
        let broken = |why: String| InstallError::Broken { program: program.clone(), why };
        let mut command = self.command("sumo");
        command.arg("--version");
        let output = keeper::output_within(command, ANSWER).map_err(|e| broken(e.to_string()))?;
        let text = String::from_utf8_lossy(&output.stdout);
        parse_version(&text).ok_or_else(|| {
            let stderr = String::from_utf8_lossy(&output.stderr);
            let said = stderr.lines().chain(text.lines()).find(|line| !line.trim().is_empty());
            broken(format!("{} ({})", said.unwrap_or("it said nothing"), output.status))
        })
    }

    /// Fails where it is too old. Asked once of each SUMO: the answer costs a process.
    ///
    /// # Errors
    /// Too old, or as [`SumoInstall::version`].
    pub fn check_version(&self) -> Result<(), InstallError> {
        static CHECKED: Mutex<Vec<SumoInstall>> = Mutex::new(Vec::new());
        if CHECKED.lock().is_ok_and(|checked| checked.contains(self)) {
            return Ok(());
        }
        let found = self.version()?;
        if found >= OLDEST_SUMO {
            if let Ok(mut checked) = CHECKED.lock() {
                checked.push(self.clone());
            }
            return Ok(());
        }
        let program = self.program("sumo");
        let found = format!("{}.{}.{}", found.0, found.1, found.2);
        Err(InstallError::TooOld { program, found, needed: OLDEST_SUMO })
    }
}

/// The home folder of a `sumo` on the PATH.
fn home_of(program: &Path) -> Option<PathBuf> {
    let program = program.canonicalize().ok().filter(|p| p.is_file())?;
    let head = std::fs::read(&program).ok()?;
    if !head.starts_with(b"#!") {
        let home = program.parent()?.parent()?;
        // Debian: /usr/bin/sumo with its data in /usr/share/sumo; programs must be found below `home`.
        return Some(home.to_owned());
    }
    // pip installs a small Python script that starts the real program; ask its Python where that is.
    // A child of a script would outlive us.
    let first = String::from_utf8_lossy(head.split(|&b| b == b'\n').next()?).into_owned();
    let interpreter = first.trim_start_matches("#!").trim();
    let mut python = Command::new(interpreter);
    python.args(["-c", "import sumo; print(sumo.SUMO_HOME)"]);
    let output = keeper::output_within(python, ANSWER).ok()?;
    let home = PathBuf::from(String::from_utf8_lossy(&output.stdout).trim());
    home.join("bin/sumo").is_file().then_some(home)
}

/// The first "N.N.N" after "sumo" in a line.
fn parse_version(text: &str) -> Option<(u32, u32, u32)> {
    let line = text.lines().find(|line| line.to_lowercase().contains("sumo"))?;
    line.split(|c: char| !(c.is_ascii_digit() || c == '.')).find_map(|word| {
        let mut numbers = word.split('.').map(str::parse::<u32>);
        match (numbers.next()?, numbers.next()?, numbers.next()) {
            (Ok(major), Ok(minor), patch) => Some((major, minor, patch.and_then(Result::ok).unwrap_or(0))),
            _ => None,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_read_from_what_sumo_prints() {
        assert_eq!(parse_version("Eclipse SUMO sumo Version 1.28.0\n Build"), Some((1, 28, 0)));
        assert_eq!(parse_version("Eclipse SUMO sumo v1_15 Version 1.15.0"), Some((1, 15, 0)));
        assert_eq!(parse_version("Eclipse SUMO sumo 1.9"), Some((1, 9, 0)));
        assert_eq!(parse_version("bash: command not found"), None);
    }

    #[test]
    fn a_variable_that_is_set_and_wrong_is_not_passed_over() {
        let error = SumoInstall::find_with(|name| (name == "WAD_COSIM_SUMO_HOME").then(|| "/nowhere".into()));
        let text = error.unwrap_err().to_string();
        assert!(text.contains("WAD_COSIM_SUMO_HOME (/nowhere)") && text.contains("scripts/setup"), "{text}");
    }

    #[test]
    fn the_cache_comes_before_sumo_home() {
        let folder = tempfile::tempdir().unwrap();
        for home in ["cache/wad-cosim/sumo-1.28.0/sumo", "other"] {
            std::fs::create_dir_all(folder.path().join(home).join("bin")).unwrap();
            std::fs::write(folder.path().join(home).join("bin/sumo"), "").unwrap();
        }
        let variable = |name: &str| match name {
            "XDG_CACHE_HOME" => Some(folder.path().join("cache").into()),
            "SUMO_HOME" => Some(folder.path().join("other").into()),
            _ => None,
        };
        let found = SumoInstall::find_with(variable).unwrap();
        assert!(found.home().ends_with("cache/wad-cosim/sumo-1.28.0/sumo"));
        // A relative cache folder is ignored; the one in the home folder is used.
        let relative = |name: &str| match name {
            "XDG_CACHE_HOME" => Some("cache".into()),
            "HOME" => Some(folder.path().join("home").into()),
            name => variable(name),
        };
        assert!(SumoInstall::find_with(relative).unwrap().home().ends_with("other"));
        let own = folder.path().join("home/.cache/wad-cosim/sumo-1.28.0/sumo/bin");
        std::fs::create_dir_all(&own).unwrap();
        std::fs::write(own.join("sumo"), "").unwrap();
        assert!(SumoInstall::find_with(relative).unwrap().home().starts_with(folder.path().join("home")));
        std::fs::remove_dir_all(folder.path().join("cache")).unwrap();
        assert!(SumoInstall::find_with(variable).unwrap().home().ends_with("other"));
    }

    #[test]
    fn a_sumo_on_the_path_that_is_no_script_is_found() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("bin")).unwrap();
        std::fs::write(folder.path().join("bin/sumo"), b"\x7fELF").unwrap();
        let found = SumoInstall::find_with(|name| (name == "PATH").then(|| folder.path().join("bin").into()));
        assert_eq!(found.unwrap().home(), folder.path().canonicalize().unwrap());
    }
}
