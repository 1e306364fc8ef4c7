//! A run's files: `config.json`, `telemetry.jsonl` (one line per tick), `summary.json`.
//!
//! Telemetry holds nothing that depends on wall time, so equal seeds give equal bytes.

use crate::autopilot::Reason;
use crate::criteria::Event;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use sumo_network::network::RoadOption;
use sumo_network::world::SignalState;
use wad_vehicle::{Control, EgoState};

/// Why a result could not be written.
#[derive(Debug, thiserror::Error)]
#[error("could not write `{}`: {source}; what was written before stays readable", path.display())]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// The system's error.
    pub source: std::io::Error,
}

/// Why there is no run folder.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder holds another run.
    #[error("`{}` already holds a run ({found}); name another folder with --out, or remove it", path.display())]
    Taken {
        /// The folder.
        path: PathBuf,
        /// The file of it that was found.
        found: &'static str,
    },
    /// The folder or a file in it cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Where the ego is on its route.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RouteRecord {
    /// SUMO lane id under the route.
    pub lane: String,
    /// Distance along the route (m).
    pub s: f64,
    /// Offset to the left of the route (m).
    pub d: f64,
    /// Where the destination lies on it (m).
    pub length: f64,
    /// Turn instruction at the ego's place.
    pub option: RoadOption,
}

/// The next signal on the route.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightRecord {
    /// What it shows.
    pub state: SignalState,
    /// Distance of its stop line (m).
    pub distance: f64,
}

/// The vehicle or pedestrian ahead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeaderRecord {
    /// Bumper to bumper (m).
    pub gap: f64,
    /// m/s.
    pub speed: f64,
}

/// One line of `telemetry.jsonl`: the control of a tick and the state after it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickRecord {
    /// Number of the tick.
    pub tick: u64,
    /// SUMO's id of the ego, in a run of several: then each tick has a line for each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// Simulation time after the tick (s).
    pub time: f64,
    /// The control of the tick.
    pub control: Control,
    /// The ego's motion after the tick.
    pub ego: EgoState,
    /// The ego's place on its route after the tick.
    pub route: RouteRecord,
    /// Speed limit (m/s).
    pub limit: f64,
    /// The next signal on the route, if there is one.
    pub light: Option<LightRecord>,
    /// The vehicle or pedestrian ahead, if there is one.
    pub leader: Option<LeaderRecord>,
    /// The reason of the autopilot's decision; None for other drivers.
    pub reason: Option<Reason>,
    /// What happened in the tick.
    pub events: Vec<Event>,
    /// Background vehicles in the network.
    pub vehicles: usize,
    /// Background pedestrians in the network.
    pub pedestrians: usize,
    /// The viewers' requests before this tick.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub wishes: Vec<Wish>,
    /// The tick's driver, if it was not the run's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driver: Option<String>,
}

/// A viewer's request to a run. It is recorded, so that the run can be driven again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "wish", rename_all = "snake_case")]
pub enum Wish {
    /// Put the ego down elsewhere.
    Respawn,
    /// Another destination from where the ego is.
    NewRoute,
    /// To the same destination from where the ego is, which has left its route.
    FindBack,
    /// Keep this much background traffic alive from now on.
    Traffic {
        /// Background vehicles.
        vehicles: usize,
        /// Background pedestrians.
        pedestrians: usize,
    },
}

/// A run's folder with its telemetry open.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    telemetry_path: PathBuf,
    telemetry: BufWriter<File>,
    line: Vec<u8>,
    unflushed: usize,
    holds_something: bool,
    /// Whether the folder was there before.
    found: bool,
}

/// Lines between flushes: what a SIGKILL can lose at most.
const FLUSH_EVERY: usize = 50;

impl RunFolder {
    /// Makes the folder and writes `config.json`.
    ///
    /// # Errors
    /// The folder holds a run already, or cannot be written.
    pub fn create(path: &Path, config: &impl Serialize) -> Result<Self, FolderError> {
        let telemetry_path = path.join("telemetry.jsonl");
        for found in ["telemetry.jsonl", "summary.json"] {
            if path.join(found).exists() {
                return Err(FolderError::Taken { path: path.to_path_buf(), found });
            }
        }
        let fail = |path: &Path| {
            let path = path.to_path_buf();
            move |source| WriteError { path, source }
        };
        let found = path.is_dir();
        std::fs::create_dir_all(path).map_err(fail(path))?;
        // Of two that begin at once only one makes it.
        let file = File::create_new(&telemetry_path).map_err(|source| match source.kind() {
            ErrorKind::AlreadyExists => {
                FolderError::Taken { path: path.to_path_buf(), found: "telemetry.jsonl" }
            }
            _ => fail(&telemetry_path)(source).into(),
        })?;
        write_json(&path.join("config.json"), config)?;
        Ok(Self {
            path: path.to_path_buf(),
            telemetry: BufWriter::with_capacity(1 << 16, file),
            telemetry_path,
            line: Vec::new(),
            unflushed: 0,
            holds_something: false,
            found,
        })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends one tick.
    pub fn record(&mut self, record: &TickRecord) -> Result<(), WriteError> {
        self.line.clear();
        let fail = |source| WriteError { path: self.telemetry_path.clone(), source };
        serde_json::to_writer(&mut self.line, record).map_err(|e| fail(e.into()))?;
        self.line.push(b'\n');
        self.telemetry.write_all(&self.line).map_err(fail)?;
        self.holds_something = true;
        self.unflushed += 1;
        if self.unflushed >= FLUSH_EVERY {
            self.flush()?;
        }
        Ok(())
    }

    /// Hands what is buffered to the system.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.unflushed = 0;
        self.telemetry.flush().map_err(|source| WriteError { path: self.telemetry_path.clone(), source })
    }

    /// Writes `summary.json`, whole or not at all.
    pub fn finish(&mut self, summary: &impl Serialize) -> Result<(), WriteError> {
        self.flush()?;
        self.holds_something = true;
        write_json(&self.path.join("summary.json"), summary)
    }
}

impl Drop for RunFolder {
    /// A run that ended before its first tick leaves nothing that stands in the way of the next.
    fn drop(&mut self) {
        if !self.holds_something {
            let _ = std::fs::remove_file(&self.telemetry_path);
            let _ = std::fs::remove_file(self.path.join("config.json"));
            if !self.found {
                // Stays where it holds anything else.
                let _ = std::fs::remove_dir(&self.path);
            }
        }
    }
}

/// Writes pretty JSON beside its place and moves it there.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), WriteError> {
    let fail = |source| WriteError { path: path.to_path_buf(), source };
    write_whole(path, &pretty_json(value).map_err(fail)?)
}

/// The bytes that [`write_json`] writes.
pub fn pretty_json(value: &impl Serialize) -> std::io::Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value)?;
    text.push(b'\n');
    Ok(text)
}

/// Writes a file whole or not at all: beside its place, and moves it there when the disk has it.
///
/// # Errors
/// It cannot be written; an earlier file stays.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    let mut staging = path.as_os_str().to_owned();
    staging.push(".tmp");
    let staging = PathBuf::from(staging);
    let written = File::create(&staging).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    written.and_then(|()| std::fs::rename(&staging, path)).map_err(|source| {
        // On a full disk half a file would only take room.
        let _ = std::fs::remove_file(&staging);
        WriteError { path: path.to_path_buf(), source }
    })
}
