//! `--view`: the live view of a run.

use super::film::Film;
use super::{Exit, agents};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use wad_cosim::assets::Assets;
use wad_cosim::bundled;
use wad_cosim::camera::{CameraConfig, Preset};
use wad_cosim::cores::Cores;
use wad_cosim::drive::{Drive, DriveError, Status};
use wad_cosim::driver::{DriverError, DriverSpec};
use wad_cosim::eyes::Eyes;
use wad_cosim::perception;
use wad_cosim::traffic::Counts;
use wad_cosim::vehicle::Control;
use wad_cosim::view::{
    Artist, DEFAULT_ADDRESS, Listener, MakeDriver, Ready, RunSetting, RunView, Token, ViewAddress, ViewError,
};

/// The live view's options.
#[derive(clap::Args, Debug)]
pub struct ViewArgs {
    /// Open a page that shows the run in the browser and lets viewers drive; the run goes at real time
    /// [default address: 127.0.0.1:8765].
    #[arg(long, value_name = "ADDR", num_args = 0..=1)]
    pub view: Option<Option<ViewAddress>>,
    /// A secret that viewers must know; required if other machines can reach the page.
    #[arg(long, value_name = "TOKEN", requires = "view")]
    view_token: Option<Token>,
    /// The run's speed in the live view, times real time; 0: as fast as possible. The page can change it.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "view")]
    pub view_speed: f64,
}

impl ViewArgs {
    /// The view of a benchmark.
    pub fn at_real_time() -> Self {
        Self { view: None, view_token: None, view_speed: 1.0 }
    }

    /// Binds the port before anything else. None without --view.
    pub fn listen(&self) -> anyhow::Result<Option<Listener>> {
        let Some(address) = self.view else { return Ok(None) };
        if !(self.view_speed == 0.0 || (0.05..=50.0).contains(&self.view_speed)) {
            return Err(Exit::Input.because(anyhow::anyhow!("--view-speed: expected 0, or 0.05 to 50")));
        }
        listen(address, self.view_token.clone()).map(Some)
    }
}

/// Listens on the address that the user named; without one on the default, or where that is in use on the next free port.
fn listen(named: Option<ViewAddress>, token: Option<Token>) -> anyhow::Result<Listener> {
    let address: ViewAddress = match named {
        Some(address) => address,
        None => DEFAULT_ADDRESS.parse().map_err(anyhow::Error::msg)?,
    };
    let listener = match Listener::bind(address, token.clone()) {
        Err(ViewError::Busy { address, free: Some(free) }) if named.is_none() => {
            super::note(format_args!("{address} is in use, perhaps by another run; using {free}"));
            Listener::bind(ViewAddress(free), token)
        }
        other => other,
    };
    let listener = listener.map_err(|e| Exit::Input.because(e))?;
    super::note(format_args!("live view: {}", listener.url()));
    Ok(listener)
}

/// Facts about the run that the page shows.
pub struct About<'a> {
    pub seed: u64,
    pub agent: &'a str,
    pub encoder: Option<&'a str>,
    pub detector: &'a str,
    pub mirrors: bool,
    pub weather: Preset,
    pub traffic: Option<Counts>,
    pub out: &'a Path,
    pub recording: Option<&'a Path>,
}

/// A run with its page.
pub struct View {
    run: RunView,
    out: PathBuf,
    /// Number of films that viewers have begun.
    films: usize,
}

impl View {
    pub fn open(
        listener: Listener,
        args: &ViewArgs,
        drive: &Drive,
        about: &About<'_>,
    ) -> anyhow::Result<Self> {
        let (assets, length) = (drive.assets(), drive.ego().params().length);
        let encoder = agents::sees_through(about.encoder, Some(about.agent));
        let artist = artist(assets, length, about.detector, Some(&encoder), about.seed)?;
        let make_driver = Some(maker(about, assets));
        let mut agents = bundled::agents();
        agents.extend(["constant", "random"].map(str::to_string));
        if !["autopilot", "manual"].contains(&about.agent) && !agents.iter().any(|name| name == about.agent) {
            agents.push(about.agent.to_string());
        }
        let setting = RunSetting {
            seed: about.seed,
            driver: about.agent.to_string(),
            weather: about.weather,
            speed_factor: args.view_speed,
            agents,
            make_driver,
            traffic: about.traffic,
            recording: about.recording.map(|path| path.display().to_string()),
            folder: about.out.display().to_string(),
        };
        let run = RunView::open(listener, drive, artist, setting)?;
        Ok(Self { run, out: about.out.to_path_buf(), films: 0 })
    }

    /// Waits until a tick is due; returns the control of a viewer who drives.
    pub async fn next(&mut self, drive: &mut Drive, film: &mut Film) -> Result<Option<Control>, DriveError> {
        loop {
            match self.run.next(drive).await? {
                Ready::Tick(control) => return Ok(control),
                Ready::Film(on) => {
                    let place = self.film(on, drive, film);
                    self.run.filming(place.as_ref().map(|path| path.as_deref()).map_err(Clone::clone), drive);
                }
            }
        }
    }

    /// Begins or ends a film in the run's folder.
    fn film(&mut self, on: bool, drive: &Drive, film: &mut Film) -> Result<Option<PathBuf>, String> {
        film.end().map_err(|e| e.to_string())?;
        if !on {
            return Ok(None);
        }
        self.films += 1;
        let ending = if cfg!(feature = "vision") { ".mp4" } else { "/" };
        let path = self.out.join(format!("film-{}{ending}", self.films));
        film.restart(&path, drive).map_err(|e| e.to_string())?;
        Ok(Some(path))
    }

    /// The cores for everything except the simulation.
    pub fn cores(&self) -> Option<Cores> {
        self.run.cores()
    }

    pub fn show(&mut self, drive: &Drive, status: &Status) {
        self.run.show(drive, status);
    }

    pub fn close(self) {
        self.run.close();
    }
}

/// Draws the town of `assets` for viewers; `seed` draws the detector's faults.
pub fn artist(
    assets: &Assets,
    length: f64,
    detector: &str,
    encoder: Option<&str>,
    seed: u64,
) -> anyhow::Result<Artist> {
    let detector =
        perception::detector(detector, perception::LeastScore::Usual).map_err(|e| Exit::Input.because(e))?;
    let eyes = Eyes::new(assets.town(), CameraConfig::default(), detector)?;
    let decoder = agents::decoder(encoder.unwrap_or("default"));
    let eyes = match &decoder {
        Some(decoder) => eyes.with_image(decoder.image_kind()),
        None => eyes,
    };
    Ok(Artist::new(assets.town(), eyes, seed, Arc::clone(assets.network()), length, decoder)?)
}

fn maker(about: &About<'_>, assets: &Arc<Assets>) -> MakeDriver {
    let (assets, encoder) = (Arc::clone(assets), about.encoder.map(str::to_string));
    let (detector, mirrors) = (about.detector.to_string(), about.mirrors);
    let make = move |name: &str| {
        let spec: DriverSpec = name.parse().map_err(|e: DriverError| e.to_string())?;
        agents::pilot(&assets, &spec, encoder.as_deref(), &detector, mirrors).map_err(|e| format!("{e:#}"))
    };
    Arc::new(make)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_named_port_that_is_taken_is_an_error_though_it_is_the_default() {
        // Another program may have it already.
        let _held = std::net::TcpListener::bind(DEFAULT_ADDRESS);
        let error = listen(Some(DEFAULT_ADDRESS.parse().unwrap()), None).err().unwrap();
        assert_eq!(Exit::of(&error), Exit::Input);
        assert!(error.to_string().contains("is free: --view"), "{error}");
        assert_ne!(listen(None, None).unwrap().address().to_string(), DEFAULT_ADDRESS);
    }
}
