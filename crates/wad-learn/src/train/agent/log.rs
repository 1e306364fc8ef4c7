//! A training's logs: `train.jsonl`, `validation.jsonl`, TensorBoard events, under cleanrl's
//! names.

use super::TrainError;
use super::curve::StagePassed;
use super::schedule::{Purpose, Report};
use crate::reward::RewardTerms;
use crate::train::tensorboard::EventWriter;
use serde_json::{Map, Value, json};
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes the logs of a run.
pub struct RunLog {
    path: PathBuf,
    lines: BufWriter<File>,
    validation: BufWriter<File>,
    events: EventWriter,
}

impl RunLog {
    /// Opens the logs in `out`, and appends to existing ones behind their first `kept` bytes ([`Self::lengths`]): what
    /// came after the checkpoint, at step `resumed`, is driven again.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn open(out: &Path, kept: [u64; 2], resumed: Option<u64>) -> Result<Self, TrainError> {
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |source| TrainError::Write { path, source }
        };
        let append = |name: &str, kept: u64| {
            let path = out.join(name);
            let file = OpenOptions::new().create(true).append(true).open(&path).map_err(failed(&path))?;
            let length = file.metadata().map_err(failed(&path))?.len();
            file.set_len(length.min(kept)).map_err(failed(&path))?;
            Ok::<_, TrainError>(BufWriter::new(file))
        };
        Ok(Self {
            path: out.to_path_buf(),
            lines: append("train.jsonl", kept[0])?,
            validation: append("validation.jsonl", kept[1])?,
            events: EventWriter::create(out, resumed).map_err(failed(out))?,
        })
    }

    /// Logs a training episode.
    ///
    /// # Errors
    /// The logs cannot be written.
    pub fn episode(
        &mut self,
        steps: u64,
        stage: usize,
        success_rate: f64,
        r: &Report,
    ) -> Result<(), TrainError> {
        let by = match r.purpose {
            Purpose::Demonstrate { .. } => "autopilot",
            Purpose::Start => "start",
            Purpose::Explore | Purpose::Validate(_) => "agent",
        };
        let mut line = report_values(steps, r);
        line.insert("by".to_string(), json!(by));
        write(&mut self.lines, &line).map_err(|source| self.failed(source))?;
        if by == "autopilot" {
            return Ok(());
        }
        let task = r.task.kind;
        let success = f64::from(u8::from(r.ending.success));
        let mut scalars = vec![
            ("charts/episodic_return".to_string(), r.episodic_return),
            ("charts/episodic_length".to_string(), r.steps as f64),
            ("charts/curriculum_stage".to_string(), stage as f64),
            ("charts/success_rate".to_string(), success_rate),
            (format!("success/{task}"), success),
            (format!("return/{task}"), r.episodic_return),
            ("charts/mean_speed".to_string(), r.mean_speed),
        ];
        if let Some(expected) = r.expected_return {
            scalars.push(("losses/expected_return".to_string(), expected));
            scalars.push(("losses/discounted_return".to_string(), r.discounted_return));
        }
        for (name, value) in RewardTerms::NAMES.iter().zip(r.terms.values()) {
            scalars.push((format!("reward/{name}"), value));
        }
        self.scalars(steps, scalars.iter().map(|(name, value)| (name.as_str(), *value)))
    }

    /// Logs metrics of the learning.
    ///
    /// # Errors
    /// The logs cannot be written.
    pub fn figures(&mut self, steps: u64, values: &[(&str, f64)]) -> Result<(), TrainError> {
        let mut line = Map::from_iter([("global_step".to_string(), json!(steps))]);
        line.extend(values.iter().map(|(name, value)| ((*name).to_string(), json!(value))));
        write(&mut self.lines, &line).map_err(|source| self.failed(source))?;
        self.scalars(steps, values.iter().copied())?;
        self.flush()
    }

    /// Logs that a stage was passed.
    ///
    /// # Errors
    /// The logs cannot be written.
    pub fn passed(&mut self, pass: &StagePassed) -> Result<(), TrainError> {
        let line = Map::from_iter([
            ("global_step".to_string(), json!(pass.step)),
            ("passed".to_string(), json!(pass)),
        ]);
        write(&mut self.lines, &line).map_err(|source| self.failed(source))?;
        self.flush()
    }

    /// Logs one episode of a validation.
    ///
    /// # Errors
    /// The logs cannot be written.
    pub fn validation_episode(&mut self, steps: u64, r: &Report) -> Result<(), TrainError> {
        let line = report_values(steps, r);
        write(&mut self.validation, &line).map_err(|source| self.failed(source))
    }

    fn scalars<'a>(
        &mut self,
        steps: u64,
        values: impl Iterator<Item = (&'a str, f64)>,
    ) -> Result<(), TrainError> {
        for (name, value) in values {
            self.events.scalar(name, steps, value).map_err(|source| self.failed(source))?;
        }
        Ok(())
    }

    /// Flushes the buffers.
    ///
    /// # Errors
    /// The logs cannot be written.
    pub fn flush(&mut self) -> Result<(), TrainError> {
        self.lines
            .flush()
            .and_then(|()| self.validation.flush())
            .and_then(|()| self.events.flush())
            .map_err(|source| self.failed(source))
    }

    /// Flushes the buffers, and gives the lengths of `train.jsonl` and `validation.jsonl` (bytes).
    ///
    /// # Errors
    /// The logs cannot be written.
    pub fn lengths(&mut self) -> Result<[u64; 2], TrainError> {
        self.flush()?;
        let length = |file: &BufWriter<File>| {
            let data = file.get_ref().metadata().map_err(|source| self.failed(source))?;
            Ok::<_, TrainError>(data.len())
        };
        Ok([length(&self.lines)?, length(&self.validation)?])
    }

    fn failed(&self, source: std::io::Error) -> TrainError {
        TrainError::Write { path: self.path.clone(), source }
    }
}

fn write(file: &mut BufWriter<File>, line: &Map<String, Value>) -> std::io::Result<()> {
    serde_json::to_writer(&mut *file, line)?;
    file.write_all(b"\n")
}

fn report_values(steps: u64, r: &Report) -> Map<String, Value> {
    let value = json!({
        "global_step": steps,
        "charts/episodic_return": r.episodic_return,
        "charts/episodic_length": r.steps,
        "discounted_return": r.discounted_return,
        "expected_return": r.expected_return,
        "stage": r.stage,
        "task": r.task.kind,
        "weather": r.task.weather,
        "end": r.ending.end,
        "cause": r.ending.cause,
        "success": r.ending.success,
        "mean_speed": r.mean_speed,
        "distance": r.distance,
        "reward": r.terms,
    });
    match value {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}
