//! `centernet` and `eyes`: the network as a detector.

use super::network::{Backbone, CenterNet, Sees};
use super::road;
use crate::perception::heads::{self, Head, Tensor as Output};
use crate::perception::{Detection, Detector, GroundPlane, PerceptionError, Seen};
use crate::weights::{Weights, WeightsError};
use std::path::Path;
use tch::{Device, Kind, TchError, Tensor};
use wad_camera::{CameraConfig, Frame};

/// Runs on one thread of the processor, or on a GPU.
#[derive(Debug)]
pub struct CenterNetDetector {
    name: String,
    network: CenterNet,
    device: Device,
    min_score: f32,
    /// The network's outputs, on the processor: heat, size, offset, and the road's light and lanes.
    outputs: [Vec<f32>; 5],
    ground: GroundPlane,
    seen: Option<Seen>,
}

impl CenterNetDetector {
    /// Reads a weights file. Detections below `min_score` (0 to 1) are dropped.
    ///
    /// # Errors
    /// The file cannot be read, or belongs to another network or camera.
    pub fn load(path: &Path, sees: Sees, min_score: f32) -> Result<Self, PerceptionError> {
        let name = format!("{}:{}", sees.network(), path.display());
        Weights::load(path)
            .and_then(|weights| Self::from_weights(name.clone(), &weights, sees, min_score))
            .map_err(|e| PerceptionError::Detector { name, why: e.to_string() })
    }

    /// A detector from weights.
    ///
    /// # Errors
    /// They belong to another network or camera.
    pub fn from_weights(
        name: String,
        weights: &Weights,
        sees: Sees,
        min_score: f32,
    ) -> Result<Self, WeightsError> {
        let network = CenterNet::from_weights(weights, sees, Device::Cpu)?;
        Ok(Self::new(name, network, Device::Cpu, min_score)?)
    }

    /// Makes a detector of a network, ready for inference.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(
        name: String,
        mut network: CenterNet,
        device: Device,
        min_score: f32,
    ) -> Result<Self, TchError> {
        network.fold()?;
        let ground = GroundPlane::new(&CameraConfig::default());
        Ok(Self { name, network, device, min_score, outputs: Default::default(), ground, seen: None })
    }

    /// The backbone.
    pub fn backbone(&self) -> Backbone {
        self.network.backbone
    }

    fn run(&mut self, rgb: &[u8], width: usize, height: usize) -> Result<Vec<Detection>, TchError> {
        let (first, rows) = self.network.backbone.rows(height);
        let bytes = &rgb[first * width * 3..][..rows * width * 3];
        let size = [1, rows as i64, width as i64, 3];
        let outputs = &mut self.outputs;
        let (shape, sees_road) = tch::no_grad(|| -> Result<([usize; 2], bool), TchError> {
            let picture = Tensor::f_from_data_size(bytes, &size, Kind::Uint8)?.f_to_device(self.device)?;
            // The permuted view keeps the channels innermost: convolutions on the processor like it so.
            let picture =
                picture.f_to_kind(Kind::Float)?.f_permute([0, 3, 1, 2])?.f_mul_scalar(1.0 / 255.0)?;
            let answer = self.network.forward(&picture, false)?;
            let shape = [2, 3].map(|k| answer.heat.size()[k] as usize);
            let mut tensors = vec![answer.heat.f_sigmoid()?, answer.size, answer.offset];
            let sees_road = answer.road.is_some();
            tensors.extend(answer.road.into_iter().flat_map(|road| [road.light, road.lanes]));
            for (tensor, out) in tensors.iter().zip(outputs.iter_mut()) {
                let tensor = tensor.f_contiguous()?.f_to_device(Device::Cpu)?;
                out.resize(tensor.numel(), 0.0);
                tensor.f_copy_data(out, tensor.numel())?;
            }
            Ok((shape, sees_road))
        })?;
        let [heat, sizes, offsets, light, lanes] = &self.outputs;
        self.seen = sees_road.then(|| road::decode(light, lanes, &self.ground));
        let tensors = [
            Output { name: "heat", shape: &[8, shape[0], shape[1]], values: heat },
            Output { name: "size", shape: &[2, shape[0], shape[1]], values: sizes },
            Output { name: "offset", shape: &[2, shape[0], shape[1]], values: offsets },
        ];
        let head = Head::SizeOffset { heat: 0, size: 1, offset: 2, classes: 8 };
        let mut found = heads::decode(&head, &tensors, width, self.min_score);
        let (right, bottom) = (width as f32, height as f32);
        for detection in &mut found {
            let [l, t, r, b] = detection.bounds;
            let [t, b] = [t + first as f32, b + first as f32];
            detection.bounds = [l.max(0.0), t.max(0.0), r.min(right), b.min(bottom)];
        }
        found.retain(|d| d.size().iter().all(|&side| side > 0.0));
        Ok(found)
    }

    /// Detects in RGB bytes of a picture.
    ///
    /// # Errors
    /// The sides are not multiples of 32, or torch fails.
    pub fn detect_rgb(
        &mut self,
        rgb: &[u8],
        width: usize,
        height: usize,
    ) -> Result<Vec<Detection>, PerceptionError> {
        if rgb.len() != width * height * 3
            || width == 0
            || !width.is_multiple_of(32)
            || !height.is_multiple_of(32)
        {
            return Err(PerceptionError::Size {
                expected: (512, 512),
                found: (width, height),
                hint: "CenterNet wants colour pictures whose sides are multiples of 32; it was trained on 512x512"
                    .to_string(),
            });
        }
        self.run(rgb, width, height)
            .map_err(|e| PerceptionError::Detector { name: self.name.clone(), why: e.to_string() })
    }
}

impl Detector for CenterNetDetector {
    fn name(&self) -> &str {
        &self.name
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
