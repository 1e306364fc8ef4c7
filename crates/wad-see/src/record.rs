//! A run as a film: chase, front or bird view, or all of them in one picture.

use crate::eyes::Eyes;
use crate::perception::stages;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use sumo_network::geometry::Pose;
use sumo_network::world::{Actor, WorldState};
use wad_camera::{Camera, CameraConfig, CameraError, Outputs, Picture, Preset, Town, Weather};

/// The view of a film.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RecordView {
    /// The ego's front camera.
    Front,
    /// From behind and above the ego.
    #[default]
    Chase,
    /// From above.
    Bird,
    /// Chase view with front and bird view inset, and what the agent gets to see, as in the paper's
    /// figure 1.
    All,
}

impl FromStr for RecordView {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "front" => Ok(Self::Front),
            "chase" => Ok(Self::Chase),
            "bird" => Ok(Self::Bird),
            "all" => Ok(Self::All),
            _ => Err(format!("unknown view `{text}`: expected front, chase, bird or all")),
        }
    }
}

/// How an .mp4 film is encoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Codec {
    /// H.264 where OpenCV can encode it, else MPEG-4 (`mp4v`).
    #[default]
    Auto,
    /// This one only, by its four-character code.
    Code([u8; 4]),
}

impl FromStr for Codec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "h264" => Ok(Self::Code(*b"avc1")),
            _ => match <[u8; 4]>::try_from(text.as_bytes()) {
                Ok(code) if code.is_ascii() => Ok(Self::Code(code)),
                _ => Err(format!(
                    "unknown codec `{text}`: expected auto, h264 or a four-character code such as avc1 or mp4v"
                )),
            },
        }
    }
}

/// Why a film cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The camera's configuration is invalid.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The path is neither a film nor a place for pictures.
    #[error(
        "cannot write a film to {path}: expected a .mp4 file, a folder that ends with `/` or a .png name for \
         numbered pictures; `run --record` takes a .mcap file too"
    )]
    Kind {
        /// The given path.
        path: PathBuf,
    },
    /// OpenCV has no encoder for the codec.
    #[error(
        "{path}: this OpenCV cannot encode {tried}. Install its FFmpeg backend (Debian, Ubuntu: apt-get install \
         libopencv-videoio-dev libavcodec-extra){}, or give a folder such as film/ for numbered pictures",
        other_codec(tried)
    )]
    Codec {
        /// The film.
        path: PathBuf,
        /// The codecs that were tried.
        tried: String,
    },
    /// A film needs a build with OpenCV.
    #[error(
        "{path}: this build has no video encoder: build it with the feature `vision`, or give a folder such as \
         film/ for numbered pictures"
    )]
    NoEncoder {
        /// The film.
        path: PathBuf,
    },
    /// The film lacks pictures at its end: OpenCV does not say that it cannot write.
    #[error(
        "could not write all of {path}: {written} pictures were made, {whole} can be read. Is the disk full? Make room \
         and film again"
    )]
    Cut {
        /// The film.
        path: PathBuf,
        /// Pictures that were made.
        written: u64,
        /// Pictures that the file holds.
        whole: u64,
    },
    /// OpenCV or the PNG encoder fails.
    #[error("cannot encode {path}: {why}")]
    Encode {
        /// The film or picture.
        path: PathBuf,
        /// What went wrong.
        why: String,
    },
}

/// Advice: a codec other than the `tried` ones.
fn other_codec(tried: &str) -> &'static str {
    if tried.contains("mp4v") { "" } else { ", ask for another codec (--record-codec mp4v)" }
}

/// A film under way.
pub struct Recorder {
    town: Town,
    view: RecordView,
    front: Option<Camera>,
    chase: Option<Camera>,
    bird: Option<Camera>,
    /// Perception's stages below the picture: how many.
    panels: usize,
    sink: Sink,
}

/// Size of the large views (pixels).
const WIDE: (usize, usize) = (1280, 720);
/// Side of the small views in the large one (pixels).
const INSET: usize = 288;

impl Recorder {
    /// A film of `town` at `path`, `fps` pictures a second. A folder or a `.png` name gives numbered pictures.
    /// `panels` of perception's stages are shown below the picture (0: none, 3, or 4 with a decoder).
    ///
    /// # Errors
    /// The path cannot be written, or there is no codec.
    pub fn create(
        path: &Path,
        town: Town,
        view: RecordView,
        fps: f64,
        codec: Codec,
        panels: usize,
    ) -> Result<Self, RecordError> {
        use RecordView::{All, Bird, Chase, Front};
        let camera = |wanted: &[RecordView], config: CameraConfig| {
            wanted.contains(&view).then(|| Camera::new(config)).transpose()
        };
        let bird = if view == All { CameraConfig::bird(INSET, INSET) } else { CameraConfig::bird(720, 720) };
        let size = match view {
            Front => (512, 512),
            Bird => (720, 720),
            Chase | All => WIDE,
        };
        // Whole numbers of pixels, even ones as video wants them.
        let size = (size.0, size.1 + panel_side(size.0, panels) / 2 * 2);
        Ok(Self {
            town,
            view,
            panels,
            front: camera(&[Front, All], CameraConfig::default())?,
            chase: camera(&[Chase, All], CameraConfig::chase(WIDE.0, WIDE.1))?,
            bird: camera(&[Bird, All], bird)?,
            sink: Sink::create(path, size, fps, codec)?,
        })
    }

    /// Moves the road users to where a tick has them, the ego too: to be called once a tick.
    pub fn follow(&mut self, world: &WorldState, ego: &Actor) {
        self.town.follow(world, Some(ego));
    }

    /// Adds a picture of the town at the last tick, around an ego at `pose`, with its percept.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, pose: &Pose, weather: Preset, eyes: Option<&Eyes>) -> Result<(), RecordError> {
        let (town, weather) = (&self.town, &Weather::from(weather));
        let shoot = |camera: &mut Option<Camera>| {
            camera.as_mut().map(|camera| {
                Picture::rgb(camera.render(town.scene(), town.actors(), pose, weather, Outputs::RGB))
            })
        };
        let (front, chase, bird) = (shoot(&mut self.front), shoot(&mut self.chase), shoot(&mut self.bird));
        let picture = match (self.view, front, chase, bird) {
            (RecordView::All, Some(front), Some(mut chase), Some(bird)) => {
                let (right, low) = (WIDE.0 - INSET - 16, WIDE.1 - INSET - 16);
                let mut put = |picture: &Picture, text: &str, x, y| {
                    let mut picture = picture.scaled(INSET, INSET);
                    picture.label(text, 0, 0, 2);
                    chase.inset(&picture, x, y);
                };
                put(&front, "front camera", right, 16);
                put(&bird, "from above", right, low);
                if let Some(mirror) = eyes.and_then(Eyes::mirror) {
                    put(&mirror.picture, if mirror.left { "left mirror" } else { "right mirror" }, 16, 16);
                }
                if let Some(image) = eyes.and_then(Eyes::image) {
                    put(&stages::transformed(image), "what the agent sees", 16, low);
                }
                chase
            }
            (_, front, chase, bird) => match front.or(chase).or(bird) {
                Some(picture) => picture,
                None => return Ok(()),
            },
        };
        if self.panels == 0 {
            return self.sink.write(&picture);
        }
        self.sink.write(&with_panels(&picture, eyes, self.panels))
    }

    /// Completes the film.
    ///
    /// # Errors
    /// It cannot be completed.
    pub fn finish(self) -> Result<(), RecordError> {
        self.sink.finish()
    }
}

/// Side of a panel (pixels) when `panels` stand below a picture `width` wide.
fn panel_side(width: usize, panels: usize) -> usize {
    width.checked_div(panels).unwrap_or(0)
}

/// The picture with the stages below it.
fn with_panels(picture: &Picture, eyes: Option<&Eyes>, panels: usize) -> Picture {
    let side = panel_side(picture.width, panels);
    let mut page = Picture::new(picture.width, picture.height + side / 2 * 2);
    page.paste(picture, 0, 0);
    if let Some(strip) = eyes.and_then(|eyes| eyes.strip(side)) {
        page.paste(&strip, (picture.width - side * panels) / 2, picture.height);
    }
    page
}

/// Where pictures go.
enum Sink {
    /// `stem-000000.png`, ...
    Pictures { folder: PathBuf, stem: String, next: u64 },
    #[cfg(feature = "vision")]
    Video(video::Video),
}

impl Sink {
    fn create(path: &Path, size: (usize, usize), fps: f64, codec: Codec) -> Result<Self, RecordError> {
        let text = path.to_string_lossy();
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if text.ends_with('/') || path.is_dir() {
            return Self::pictures(path.to_path_buf(), "frame".to_string());
        }
        match extension.as_deref() {
            Some("png") => Self::pictures(
                path.parent().map(Path::to_path_buf).unwrap_or_default(),
                path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            ),
            #[cfg(feature = "vision")]
            Some("mp4") => {
                if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
                    std::fs::create_dir_all(folder)
                        .map_err(|source| RecordError::Write { path: folder.to_path_buf(), source })?;
                }
                // OpenCV does not report why a file cannot be written; the system does.
                std::fs::File::create(path)
                    .map_err(|source| RecordError::Write { path: path.to_path_buf(), source })?;
                Ok(Self::Video(video::Video::create(path, size, fps, codec)?))
            }
            #[cfg(not(feature = "vision"))]
            Some("mp4") => {
                let _ = (size, fps, codec);
                Err(RecordError::NoEncoder { path: path.to_path_buf() })
            }
            _ => Err(RecordError::Kind { path: path.to_path_buf() }),
        }
    }

    /// Tries whether the first of them can be written.
    fn pictures(folder: PathBuf, stem: String) -> Result<Self, RecordError> {
        let path = numbered(&folder, &stem, 0);
        Picture::can_save(&path).map_err(|source| RecordError::Write { path, source })?;
        Ok(Self::Pictures { folder, stem, next: 0 })
    }

    fn write(&mut self, picture: &Picture) -> Result<(), RecordError> {
        match self {
            Self::Pictures { folder, stem, next } => {
                let path = numbered(folder, stem, *next);
                *next += 1;
                picture.save(&path).map_err(|source| RecordError::Write { path, source })
            }
            #[cfg(feature = "vision")]
            Self::Video(video) => video.write(picture),
        }
    }

    fn finish(self) -> Result<(), RecordError> {
        match self {
            Self::Pictures { .. } => Ok(()),
            #[cfg(feature = "vision")]
            Self::Video(video) => video.finish(),
        }
    }
}

/// `film/frame-000012.png`.
fn numbered(folder: &Path, stem: &str, number: u64) -> PathBuf {
    folder.join(format!("{stem}-{number:06}.png"))
}

#[cfg(feature = "vision")]
mod video {
    use super::{Codec, Picture, RecordError};
    use opencv::core::{Mat, Size, Vec3b};
    use opencv::prelude::{VideoCaptureTraitConst, VideoWriterTrait, VideoWriterTraitConst};
    use opencv::videoio::{CAP_ANY, CAP_PROP_FRAME_COUNT, VideoCapture, VideoWriter};
    use std::path::{Path, PathBuf};

    /// An .mp4 file under way.
    pub struct Video {
        writer: VideoWriter,
        path: PathBuf,
        line: Vec<Vec3b>,
        written: u64,
    }

    impl Video {
        /// Nothing is left at `path` if there is no codec.
        pub fn create(
            path: &Path,
            (width, height): (usize, usize),
            fps: f64,
            codec: Codec,
        ) -> Result<Self, RecordError> {
            let failed = |e: opencv::Error| RecordError::Encode { path: path.to_path_buf(), why: e.message };
            let codes = match codec {
                Codec::Auto => vec![*b"avc1", *b"mp4v"],
                Codec::Code(code) => vec![code],
            };
            for code in &codes {
                let [a, b, c, d] = code.map(char::from);
                let fourcc = VideoWriter::fourcc(a, b, c, d).map_err(failed)?;
                let size = Size::new(width as i32, height as i32);
                let writer = VideoWriter::new(path, fourcc, fps, size, true).map_err(failed)?;
                if writer.is_opened().map_err(failed)? {
                    return Ok(Self { writer, path: path.to_path_buf(), line: Vec::new(), written: 0 });
                }
                tracing::warn!("this OpenCV cannot encode {}", String::from_utf8_lossy(code));
            }
            // A file that cannot be removed is empty at worst.
            let _ = std::fs::remove_file(path);
            let tried = codes.iter().map(|c| String::from_utf8_lossy(c)).collect::<Vec<_>>().join(" or ");
            Err(RecordError::Codec { path: path.to_path_buf(), tried })
        }

        pub fn write(&mut self, picture: &Picture) -> Result<(), RecordError> {
            self.written += 1;
            self.line.clear();
            self.line.extend(picture.rgb.chunks_exact(3).map(|p| Vec3b::from([p[2], p[1], p[0]])));
            let (rows, columns) = (picture.height as i32, picture.width as i32);
            Mat::new_rows_cols_with_data(rows, columns, &self.line)
                .and_then(|mat| self.writer.write(&mat))
                .map_err(|e| RecordError::Encode { path: self.path.clone(), why: e.message })
        }

        pub fn finish(mut self) -> Result<(), RecordError> {
            let failed = |e: opencv::Error| RecordError::Encode { path: self.path.clone(), why: e.message };
            self.writer.release().map_err(failed)?;
            let whole = pictures_in(&self.path).map_err(failed)?;
            if whole < self.written {
                return Err(RecordError::Cut { path: self.path, written: self.written, whole });
            }
            Ok(())
        }
    }

    /// How many pictures the film at `path` holds; none where it cannot be read.
    fn pictures_in(path: &Path) -> opencv::Result<u64> {
        let film = VideoCapture::from_file(path, CAP_ANY)?;
        if !film.is_opened()? {
            return Ok(0);
        }
        // As a cast, what is below 0 is 0.
        Ok(film.get(CAP_PROP_FRAME_COUNT)? as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::network::{Network, Shapes};

    #[test]
    fn a_film_has_a_place_that_can_hold_it() {
        let folder = tempfile::tempdir().unwrap();
        let net = Network::load(&wad_sim::bundled::resolve("town3.net.xml").unwrap()).unwrap();
        let town = Town::new(&net, &Shapes::default(), wad_camera::scene::Look::of(0));
        let at = |name: &str| {
            Recorder::create(&folder.path().join(name), town.share(), RecordView::Front, 6.0, Codec::Auto, 0)
        };
        assert!(at("frames/").is_ok() && at("new/film.png").is_ok());
        std::fs::write(folder.path().join("file"), "").unwrap();
        let error = at("file/film.png").err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("cannot write") && error.contains("film-000000.png"), "{error}");
        let error = at("film.avi").err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("film.avi") && error.contains(".mp4"), "{error}");
        assert_eq!("h264".parse(), Ok(Codec::Code(*b"avc1")));
        assert!("divx5".parse::<Codec>().unwrap_err().contains("mp4v"));
        assert!("side".parse::<RecordView>().unwrap_err().contains("chase"));
    }
}
