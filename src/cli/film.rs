//! The film of a run, and perception for `run`.

use super::Exit;
use std::path::Path;
use wad_cosim::camera::CameraConfig;
use wad_cosim::drive::{Drive, Status};
use wad_cosim::eyes::Eyes;
use wad_cosim::foxglove::{DriveLog, Moment};
use wad_cosim::latent::Decoder;
use wad_cosim::perception;
use wad_cosim::record::{Codec, RecordError, RecordView, Recorder};
use wad_cosim::reward::RewardTerms;
use wad_cosim::view::score::{Score, Tick};

/// Options of film and perception.
pub struct Wanted<'a> {
    /// None: no film.
    pub path: Option<&'a Path>,
    pub view: RecordView,
    pub codec: Codec,
    /// Perception's stages too.
    pub perception: bool,
    pub detector: &'a str,
}

/// The film of the run, if there is one, and whether perception runs.
#[derive(Default)]
pub struct Film {
    recorder: Option<Recorder>,
    /// The drive as data, and the score for it.
    log: Option<(DriveLog, Score)>,
    looks: bool,
}

impl Film {
    /// Begins the film, if there is one. `decoder` makes the reconstruction.
    ///
    /// # Errors
    /// No such detector, or the film's place cannot be written.
    pub fn begin(
        drive: &mut Drive,
        wanted: &Wanted<'_>,
        decoder: Option<Box<dyn Decoder>>,
    ) -> anyhow::Result<Self> {
        let (logged, filmed) = match wanted.path {
            Some(path) if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap")) => {
                (Some(path), None)
            }
            path => (None, path),
        };
        // The film of all views includes the transformed image, the log the picture and its boxes.
        let inset = filmed.is_some() && wanted.view == RecordView::All;
        let looks = wanted.perception || inset || logged.is_some();
        if looks {
            let detector = perception::detector(wanted.detector, perception::LeastScore::Usual)
                .map_err(|e| Exit::Input.because(e))?;
            let eyes = Eyes::new(drive.assets().town(), CameraConfig::default(), detector)
                .map_err(|e| Exit::Input.because(e))?;
            drive.watch_with(match decoder {
                Some(decoder) => eyes.with_decoder(decoder),
                None => eyes,
            });
        }
        let panels = if wanted.perception { drive.eyes().panels() } else { 0 };
        let fps = 1.0 / drive.bridge().tick();
        let create = |path: &Path| {
            Recorder::create(path, drive.assets().town(), wanted.view, fps, wanted.codec, panels)
        };
        let recorder = filmed.map(create).transpose().map_err(|e| Exit::Input.because(e))?;
        let log = |path: &Path| DriveLog::create(path, drive.bridge().network(), CameraConfig::default());
        let log = logged.map(log).transpose().map_err(|e| Exit::Input.because(e))?;
        Ok(Self { recorder, log: log.map(|log| (log, Score::default())), looks })
    }

    /// Runs perception if it is on, and adds the tick to film and log.
    ///
    /// # Errors
    /// A stage of perception fails, or the film cannot be written.
    pub fn add(&mut self, drive: &mut Drive, status: &Status) -> anyhow::Result<()> {
        if self.looks {
            drive.look()?;
        }
        if let Some(recorder) = &mut self.recorder {
            let ego = drive.ego();
            recorder.follow(ego.world(), &ego.as_actor());
            recorder.add(&ego.state().pose, drive.weather(), Some(drive.eyes()))?;
        }
        if let Some((log, score)) = &mut self.log {
            score.count(&Tick::of(drive, status));
            let (ego, eyes) = (drive.ego(), drive.eyes());
            log.add(&Moment {
                time: status.record.time,
                ego: &ego.as_actor(),
                world: ego.world(),
                frame: eyes.frame(),
                detections: eyes.percept().map_or(&[], |percept| &percept.detections),
                reward: &RewardTerms::NAMES.into_iter().zip(score.terms.values()).collect::<Vec<_>>(),
            })?;
        }
        Ok(())
    }

    /// Begins a film from the next tick on, from behind.
    pub fn restart(&mut self, path: &Path, drive: &Drive) -> Result<(), RecordError> {
        let (town, fps) = (drive.assets().town(), 1.0 / drive.bridge().tick());
        self.recorder = Some(Recorder::create(path, town, RecordView::Chase, fps, Codec::Auto, 0)?);
        Ok(())
    }

    /// Completes the running film and the log, if there are any.
    pub fn end(&mut self) -> Result<(), RecordError> {
        self.log.take().map_or(Ok(()), |(log, _)| log.finish())?;
        self.recorder.take().map_or(Ok(()), Recorder::finish)
    }
}
