//! The film of a run, and perception for `run`.

use super::Exit;
use std::path::Path;
use wad_cosim::camera::CameraConfig;
use wad_cosim::drive::Drive;
use wad_cosim::eyes::Eyes;
use wad_cosim::latent::Decoder;
use wad_cosim::perception;
use wad_cosim::record::{Codec, RecordError, RecordView, Recorder};

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
        // The film of all views includes the transformed image.
        let inset = wanted.path.is_some() && wanted.view == RecordView::All;
        let looks = wanted.perception || inset;
        if looks {
            let detector = perception::detector(wanted.detector, perception::MIN_SCORE)
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
        let recorder = wanted.path.map(create).transpose().map_err(|e| Exit::Input.because(e))?;
        Ok(Self { recorder, looks })
    }

    /// Runs perception if it is on, and adds a picture of the tick.
    ///
    /// # Errors
    /// A stage of perception fails, or the film cannot be written.
    pub fn add(&mut self, drive: &mut Drive) -> anyhow::Result<()> {
        if self.looks {
            drive.look()?;
        }
        if let Some(recorder) = &mut self.recorder {
            let ego = drive.ego();
            recorder.follow(ego.world(), &ego.as_actor());
            recorder.add(&ego.state().pose, drive.weather(), Some(drive.eyes()))?;
        }
        Ok(())
    }

    /// Begins a film from the next tick on, from behind.
    pub fn restart(&mut self, path: &Path, drive: &Drive) -> Result<(), RecordError> {
        let (town, fps) = (drive.assets().town(), 1.0 / drive.bridge().tick());
        self.recorder = Some(Recorder::create(path, town, RecordView::Chase, fps, Codec::Auto, 0)?);
        Ok(())
    }

    /// Completes the running film, if there is one.
    pub fn end(&mut self) -> Result<(), RecordError> {
        self.recorder.take().map_or(Ok(()), Recorder::finish)
    }
}
