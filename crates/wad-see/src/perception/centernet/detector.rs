//! `centernet` and `eyes`: the network as a detector.

use super::decode;
use super::graph::{self, Numbers, PICTURE, Ranges};
use super::kind::{self, Backbone, CLASSES, Part, STRIDE, Sees};
#[cfg(feature = "learn")]
use super::network::CenterNet;
use super::reader::{self, SignReader};
use crate::inference::{self, InferenceError};
use crate::perception::coco::join_guesses;
use crate::perception::heads::{self, Head, Tensor as Output};
use crate::perception::{Detection, Detector, GroundPlane, LeastScore, PerceptionError, Seen, SeenSign};
use crate::weights::{Weights, WeightsError};
use std::path::Path;
#[cfg(feature = "learn")]
use tch::{Device, Kind, TchError, Tensor};
use wad_camera::{CameraConfig, Frame};
use wad_sim::stats::quantile;

/// Runs on one thread of the processor, or on a GPU.
#[derive(Debug)]
pub struct CenterNetDetector {
    name: String,
    backbone: Backbone,
    engine: Engine,
    least: LeastScore,
    outputs: Outputs,
    ground: GroundPlane,
    /// Where it sees signs.
    reader: Option<SignReader>,
    seen: Option<Seen>,
}

/// What computes the network.
#[derive(Debug)]
enum Engine {
    /// In single precision; where it sees objects alone, any size of picture.
    #[cfg(feature = "learn")]
    Torch { network: Box<CenterNet>, device: Device },
    /// Pictures of the camera.
    OpenVino { network: inference::Network, sees: Sees },
}

/// The network's outputs for one picture.
#[derive(Debug, Default)]
struct Outputs {
    /// Height and width of the maps (cells).
    shape: [usize; 2],
    /// Objects (heatmap before its sigmoid, size, offset), and the road's light, lanes, signs and area: see [`decode`].
    maps: [Vec<f32>; 5],
    /// Whether the last four are of this picture.
    sees_road: bool,
}

/// Why a picture gave no outputs.
enum Broken {
    #[cfg(feature = "learn")]
    Torch(TchError),
    Inference(InferenceError),
}

/// What computes the networks of these weights here, for manifests: networks' numbers differ a little between them.
/// None: libtorch, in single precision.
///
/// # Errors
/// As [`CenterNetDetector::from_weights`].
pub fn engine(weights: &Weights, sees: Sees) -> Result<Option<String>, WeightsError> {
    Ok(match how(weights, sees)? {
        How::Torch => None,
        How::OpenVino(ranges) => {
            Some(format!("OpenVINO, {}", if ranges.is_some() { "8 bits" } else { "single precision" }))
        }
    })
}

enum How {
    Torch,
    OpenVino(Option<Ranges>),
}

/// With 8 bits by OpenVINO where the weights have ranges. Without ranges, or without OpenVINO, by libtorch, if this
/// program has it.
fn how(weights: &Weights, sees: Sees) -> Result<How, WeightsError> {
    let backbone = kind::backbone(weights, sees)?;
    let ranges = graph::ranges(weights)?;
    let has_torch = cfg!(feature = "learn");
    if backbone != Backbone::Light || (ranges.is_none() && has_torch) {
        return Ok(How::Torch);
    }
    match inference::available() {
        Ok(()) => Ok(How::OpenVino(ranges)),
        Err(InferenceError::Off) if has_torch => Ok(How::Torch),
        Err(why) if has_torch => {
            tracing::warn!("the detector runs on libtorch, at a third of its speed: {why}");
            Ok(How::Torch)
        }
        Err(why) => Err(WeightsError::Inference(why)),
    }
}

impl CenterNetDetector {
    /// Reads a weights file. Detections with less than the `least` score are dropped.
    ///
    /// # Errors
    /// The file cannot be read, or belongs to another network or camera.
    pub fn load(path: &Path, sees: Sees, least: LeastScore) -> Result<Self, PerceptionError> {
        let name = format!("{}:{}", sees.network(), path.display());
        Weights::load(path)
            .and_then(|weights| Self::from_weights(name.clone(), &weights, sees, least))
            .map_err(|e| PerceptionError::Detector { name, why: e.to_string() })
    }

    /// A detector from weights.
    ///
    /// # Errors
    /// They belong to another network or camera, or nothing here can compute them.
    pub fn from_weights(
        name: String,
        weights: &Weights,
        sees: Sees,
        least: LeastScore,
    ) -> Result<Self, WeightsError> {
        match how(weights, sees)? {
            #[cfg(feature = "learn")]
            How::Torch => {
                let network = CenterNet::from_weights(weights, sees, Device::Cpu)?;
                Ok(Self::new(name, network, Device::Cpu, least)?)
            }
            #[cfg(not(feature = "learn"))]
            How::Torch => Err(WeightsError::NoTorch),
            How::OpenVino(ranges) => {
                let numbers = ranges.as_ref().map_or(Numbers::Single, Numbers::Whole);
                let ir = graph::graph(weights, sees, numbers)?;
                let engine = Engine::OpenVino { network: inference::Network::new(&ir, &SHAPE)?, sees };
                let reader = (sees == Sees::Road)
                    .then(|| SignReader::new(|name, shape| weights.floats(name, shape)))
                    .transpose()?;
                Ok(Self::of(name, Backbone::Light, engine, reader, least))
            }
        }
    }

    /// Makes a detector of a network, ready for inference by libtorch.
    ///
    /// # Errors
    /// torch fails.
    #[cfg(feature = "learn")]
    pub fn new(
        name: String,
        mut network: CenterNet,
        device: Device,
        least: LeastScore,
    ) -> Result<Self, TchError> {
        network.fold()?;
        let (backbone, reader) = (network.backbone, network.sign_reader()?);
        Ok(Self::of(name, backbone, Engine::Torch { network: Box::new(network), device }, reader, least))
    }

    fn of(
        name: String,
        backbone: Backbone,
        engine: Engine,
        reader: Option<SignReader>,
        least: LeastScore,
    ) -> Self {
        let ground = GroundPlane::new(&CameraConfig::default());
        Self { name, backbone, engine, least, outputs: Outputs::default(), ground, reader, seen: None }
    }

    /// Detects in RGB bytes of a picture.
    ///
    /// # Errors
    /// The sides are not multiples of 32 (by OpenVINO, and where it sees the road: not the camera's), or the network fails.
    pub fn detect_rgb(
        &mut self,
        rgb: &[u8],
        width: usize,
        height: usize,
    ) -> Result<Vec<Detection>, PerceptionError> {
        let whole = ([width, height] == [512, 512], "this network sees whole pictures of the front camera");
        let (fits, hint) = match &self.engine {
            #[cfg(feature = "learn")]
            Engine::Torch { network, .. } if network.sees() == Sees::Objects => (
                width > 0 && width.is_multiple_of(32) && height.is_multiple_of(32),
                "CenterNet wants colour pictures whose sides are multiples of 32; it was trained on 512x512",
            ),
            #[cfg(feature = "learn")]
            Engine::Torch { .. } => whole,
            Engine::OpenVino { .. } => whole,
        };
        if !fits || rgb.len() != width * height * 3 {
            let hint = hint.to_string();
            return Err(PerceptionError::Size { expected: (512, 512), found: (width, height), hint });
        }
        let (first, rows) = self.backbone.rows(height);
        let bytes = &rgb[first * width * 3..][..rows * width * 3];
        self.engine.run(bytes, [rows, width], &mut self.outputs).map_err(|broken| {
            let why = match broken {
                #[cfg(feature = "learn")]
                Broken::Torch(e) => e.to_string(),
                Broken::Inference(e) => e.to_string(),
            };
            PerceptionError::Detector { name: self.name.clone(), why }
        })?;
        let Outputs { shape: [h, w], maps: [objects, road @ ..], sees_road } = &self.outputs;
        self.seen = sees_road.then(|| decode::decode(road, &self.ground));
        if let (Some(seen), Some(reader)) = (&mut self.seen, &self.reader) {
            for place in &mut seen.signs {
                // What is less sure than that cannot be read more surely.
                *place = place.filter(|found| found.certainty >= LEAST_READ).and_then(|found| {
                    let plate = reader::plate(rgb, width, found.pixel, found.radius);
                    let (sign, likely) = reader.read(&plate)?;
                    let certainty = found.certainty * likely;
                    (certainty >= LEAST_READ).then_some(SeenSign { sign, certainty, ..found })
                });
            }
        }
        let plane = h * w;
        let (heat, boxes) = objects.split_at(CLASSES as usize * plane);
        let (sizes, offsets) = boxes.split_at(2 * plane);
        let tensors = [
            Output { name: "heat", shape: &[CLASSES as usize, *h, *w], values: heat },
            Output { name: "size", shape: &[2, *h, *w], values: sizes },
            Output { name: "offset", shape: &[2, *h, *w], values: offsets },
        ];
        let head = Head::SizeOffset { heat: 0, size: 1, offset: 2, classes: CLASSES as usize };
        let least = self.least.of(f32::INFINITY).min(LEAST_SHARE);
        let mut found = heads::decode(&head, &tensors, width, decode::logit(least));
        found.iter_mut().for_each(|d| d.score = decode::sigmoid(d.score));
        join_guesses(&mut found, ONE_VEHICLE);
        for detection in &mut found {
            let [l, t, r, b] = detection.bounds;
            detection.bounds = [l, t + first as f32, r, b + first as f32];
        }
        let area = self.seen.as_ref().map(|seen| &seen.area);
        found.retain(|detection| self.least.keeps(detection, area));
        heads::clip(&mut found, [width as f32, height as f32]);
        Ok(found)
    }
}

/// A class adds to the certainty of a vehicle from this score on, and to which: boxes that overlap by more are one (IoU).
const LEAST_SHARE: f32 = 0.05;
const ONE_VEHICLE: f32 = 0.6;

/// Least certainty that a sign is there and says what was read. What is unsure in one picture [votes](crate::perception::SeenLimit)
/// in many.
const LEAST_READ: f32 = 0.4;

/// The shape of OpenVINO's input.
const SHAPE: [usize; 4] = [1, PICTURE[0], PICTURE[1], 3];

impl Engine {
    /// `size`: rows and columns of the picture's bytes.
    fn run(&mut self, bytes: &[u8], size: [usize; 2], outputs: &mut Outputs) -> Result<(), Broken> {
        match self {
            #[cfg(feature = "learn")]
            Self::Torch { network, device } => {
                run_torch(network, *device, bytes, size, outputs).map_err(Broken::Torch)
            }
            Self::OpenVino { network, sees } => {
                outputs.shape = size.map(|side| side / STRIDE);
                outputs.sees_road = *sees == Sees::Road;
                let run = network.run(bytes, |at, numbers| {
                    outputs.maps[at].clear();
                    outputs.maps[at].extend_from_slice(numbers);
                });
                run.map_err(Broken::Inference)
            }
        }
    }
}

#[cfg(feature = "learn")]
fn run_torch(
    network: &CenterNet,
    device: Device,
    bytes: &[u8],
    [rows, columns]: [usize; 2],
    outputs: &mut Outputs,
) -> Result<(), TchError> {
    tch::no_grad(|| {
        let size = [1, rows as i64, columns as i64, 3];
        let picture = Tensor::f_from_data_size(bytes, &size, Kind::Uint8)?.f_to_device(device)?;
        // The permuted view keeps the channels innermost: convolutions on the processor like it so.
        let picture = picture.f_to_kind(Kind::Float)?.f_permute([0, 3, 1, 2])?.f_mul_scalar(1.0 / 255.0)?;
        let answer = network.forward(&picture, false)?;
        outputs.shape = [2, 3].map(|k| answer.heat.size()[k] as usize);
        outputs.sees_road = answer.road.is_some();
        let mut tensors = vec![Tensor::f_cat(&[answer.heat, answer.size, answer.offset], 1)?];
        tensors
            .extend(answer.road.into_iter().flat_map(|road| [road.light, road.lanes, road.signs, road.area]));
        for (tensor, map) in tensors.iter().zip(outputs.maps.iter_mut()) {
            let tensor = tensor.f_contiguous()?.f_to_device(Device::Cpu)?;
            map.resize(tensor.numel(), 0.0);
            tensor.f_copy_data(map, tensor.numel())?;
        }
        Ok(())
    })
}

impl Detector for CenterNetDetector {
    fn name(&self) -> &str {
        &self.name
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(CameraConfig::default())
    }

    fn detect(
        &mut self,
        frame: &Frame,
        _camera: &CameraConfig,
        found: &mut Vec<Detection>,
    ) -> Result<(), PerceptionError> {
        *found = self.detect_rgb(&frame.rgb, frame.width, frame.height)?;
        Ok(())
    }

    fn seen(&self) -> Option<&Seen> {
        self.seen.as_ref()
    }
}

/// Finds the ranges of a network's numbers, with which it runs in 8 bits: it watches the network see pictures.
#[derive(Debug)]
pub struct Watcher {
    network: inference::Network,
    /// Outputs before the watched places.
    answers: usize,
    /// The largest number of each place, picture by picture.
    most: Vec<Vec<f64>>,
}

/// Share of the pictures of which no number lies beyond its place's range.
const WITHIN: f64 = 0.99;

/// A place's range, by the largest number in each picture. Not their mean: few pictures show what is near, whose size is a
/// large number, and what is beyond the range looks as small as the range.
fn range(most: Vec<f64>) -> f32 {
    quantile(most, WITHIN).max(1e-6) as f32 // none: 1e-6
}

impl Watcher {
    /// Watches the network of some weights.
    ///
    /// # Errors
    /// They belong to another network or camera, or there is no OpenVINO.
    pub fn new(weights: &Weights, sees: Sees) -> Result<Self, WeightsError> {
        let ir = graph::graph(weights, sees, Numbers::Watched)?;
        let network = inference::Network::new(&ir, &SHAPE)?;
        let answers = if sees == Sees::Road { 5 } else { 1 };
        Ok(Self { network, answers, most: vec![Vec::new(); ir.outputs() - answers] })
    }

    /// Shows it a picture of the camera (512x512 RGB).
    ///
    /// # Errors
    /// OpenVINO fails.
    pub fn show(&mut self, rgb: &[u8]) -> Result<(), WeightsError> {
        let (first, rows) = Backbone::Light.rows(PICTURE[1]);
        let bytes = &rgb[first * PICTURE[1] * 3..][..rows * PICTURE[1] * 3];
        let Self { network, answers, most } = self;
        network.run(bytes, |at, numbers| {
            let Some(place) = at.checked_sub(*answers) else { return };
            most[place].push(f64::from(numbers.iter().copied().fold(0.0, f32::max)));
        })?;
        Ok(())
    }

    /// The same weights with the ranges of nearly all pictures. All but the head's own are those of `before`, of which the
    /// network was made and which differs in that head alone, if it has as many.
    ///
    /// # Errors
    /// Those of `before` cannot be read.
    pub fn finish(
        self,
        mut weights: Weights,
        before: Option<(&Weights, Part)>,
    ) -> Result<Weights, WeightsError> {
        let mut ranges: Ranges = self.most.into_iter().map(range).collect();
        if let Some((before, part)) = before {
            keep(&mut ranges, &graph::ranges(before)?.unwrap_or_default(), graph::ranges_of(part));
        }
        graph::set_ranges(&mut weights, &ranges);
        Ok(weights)
    }
}

/// Puts the ranges `before` in place of all but the last `own`. Those of another number of places are of other places.
fn keep(ranges: &mut [f32], before: &[f32], own: usize) {
    if before.len() == ranges.len() {
        let others = ranges.len().saturating_sub(own);
        ranges[..others].copy_from_slice(&before[..others]);
    }
}

#[cfg(test)]
mod tests {
    use super::{keep, range};

    #[test]
    fn ranges_of_another_number_of_places_are_not_kept() {
        let kept = |before: &[f32]| {
            let mut ranges = [1.0, 2.0, 3.0];
            keep(&mut ranges, before, 1);
            ranges
        };
        assert_eq!(kept(&[7.0, 8.0, 9.0]), [7.0, 8.0, 3.0]);
        assert_eq!(kept(&[7.0, 8.0]), [1.0, 2.0, 3.0]);
        assert_eq!(kept(&[7.0, 8.0, 9.0, 10.0]), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn what_few_pictures_show_is_within_the_range() {
        // Of 101 pictures four show something near, one something that nobody sees twice.
        let mut most = vec![1.0; 96];
        most.extend([4.0; 4]);
        most.push(100.0);
        assert_eq!(range(most), 4.0);
        assert!(range(Vec::new()) > 0.0 && range(vec![0.0; 3]) > 0.0, "a range that can be divided by");
    }
}
