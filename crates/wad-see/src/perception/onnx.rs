//! `onnx:FILE`: any COCO detector in ONNX, through OpenCV's dnn on one thread.

use super::heads::{self, Head, Tensor};
use super::{Detection, Detector, PerceptionError, onnx_file};
use opencv::core::{CV_8UC3, CV_32F, Mat, Rect, Scalar, Size, Vector};
use opencv::prelude::{MatTraitConst, MatTraitConstManual, NetTrait, NetTraitConst};
use opencv::{dnn, imgproc};
use std::path::{Path, PathBuf};
use wad_camera::{CameraConfig, Frame};

/// Side of the input where the file leaves it open (pixels).
const OPEN_SIDE: usize = 640;
/// Largest side of an input (pixels): pictures of the front camera have 512.
const LARGEST_SIDE: usize = 4096;
/// Grey level of the part of the input that the picture leaves empty.
const FILL: f64 = 114.0;

/// A detector from a file.
///
/// The picture goes in as RGB, scaled to fit the upper left of the input. CenterNets get 0 to 255, YOLOs 0
/// to 1, as they are usually exported.
pub struct OnnxDetector {
    name: String,
    net: dnn::Net,
    input: String,
    /// Width and height of the network's input (pixels).
    size: (usize, usize),
    outputs: Vec<String>,
    head: Head,
    min_score: f32,
}

impl OnnxDetector {
    /// Loads a file and tries it on an empty picture. Detections below `min_score` (0 to 1) are dropped.
    ///
    /// # Errors
    /// The file cannot be read, is not ONNX, has no head that [`heads`] knows, or OpenCV cannot load it.
    pub fn load(path: &Path, min_score: f32) -> Result<Self, PerceptionError> {
        let name = format!("onnx:{}", path.display());
        let failed = |why: String| PerceptionError::Detector { name: name.clone(), why };
        let bytes = std::fs::read(path).map_err(|e| {
            failed(format!("cannot read the file: {e}. scripts/fetch-detector fetches one to try"))
        })?;
        let input = onnx_file::input(&bytes).map_err(&failed)?;
        let &[batch, channels, height, width] = input.shape.as_slice() else {
            return Err(failed(format!(
                "its input {} has {} dimensions: expected [1, 3, height, width]",
                input.name,
                input.shape.len()
            )));
        };
        if batch.unwrap_or(1) != 1 || channels.unwrap_or(3) != 3 {
            return Err(failed(format!(
                "its input {} is {:?}: expected one picture of three channels, [1, 3, height, width]",
                input.name, input.shape
            )));
        }
        let size = (width.unwrap_or(OPEN_SIDE), height.unwrap_or(OPEN_SIDE));
        if size.0 > LARGEST_SIDE || size.1 > LARGEST_SIDE {
            return Err(failed(format!(
                "its input {} is {} x {} pixels: expected sides up to {LARGEST_SIDE}",
                input.name, size.0, size.1
            )));
        }
        let refused = |e: opencv::Error| {
            failed(format!(
                "OpenCV cannot run it: {}. Try to export it with opset 11 and fixed sizes",
                e.message.trim()
            ))
        };
        opencv::core::set_num_threads(1).map_err(refused)?;
        let net = dnn::read_net_from_onnx_buffer(&Vector::from_slice(&bytes)).map_err(refused)?;
        let outputs = net.get_unconnected_out_layers_names().map_err(refused)?.iter().collect();
        let mut detector = Self {
            name: name.clone(),
            net,
            input: input.name,
            size,
            outputs,
            head: Head::Finished,
            min_score,
        };
        let (width, height) = detector.size;
        let empty = Frame { width, height, rgb: vec![0; width * height * 3], ..Frame::default() };
        let shapes: Vec<Vec<usize>> = detector.forward(&empty).map_err(refused)?.iter().map(shape).collect();
        let named: Vec<(&str, &[usize])> =
            detector.outputs.iter().map(String::as_str).zip(shapes.iter().map(Vec::as_slice)).collect();
        detector.head = heads::recognise(&named).map_err(failed)?;
        Ok(detector)
    }

    /// The file of [`Self::load`] if none is named: `scripts/fetch-detector` writes it.
    pub fn default_path() -> Option<PathBuf> {
        Some(wad_sim::bundled::cache_in(|name| std::env::var_os(name))?.join("centernet-coco.onnx"))
    }

    /// The outputs for a frame, in the order of `outputs`.
    fn forward(&mut self, frame: &Frame) -> opencv::Result<Vec<Mat>> {
        let bytes = Mat::new_rows_cols_with_bytes::<opencv::core::Vec3b>(
            frame.height as i32,
            frame.width as i32,
            &frame.rgb,
        )?;
        let size = Size::new(self.size.0 as i32, self.size.1 as i32);
        let mut fitted = Mat::default();
        let picture: &Mat = if (frame.width, frame.height) == self.size {
            fitted = bytes.try_clone()?;
            &fitted
        } else {
            let scale = self.scale(frame);
            let part = Size::new(
                ((frame.width as f32 * scale).round() as i32).clamp(1, size.width),
                ((frame.height as f32 * scale).round() as i32).clamp(1, size.height),
            );
            let mut canvas = Mat::new_size_with_default(size, CV_8UC3, Scalar::all(FILL))?;
            imgproc::resize(&bytes, &mut fitted, part, 0.0, 0.0, imgproc::INTER_AREA)?;
            let mut place = Mat::roi_mut(&mut canvas, Rect::new(0, 0, part.width, part.height))?;
            fitted.copy_to(&mut place)?;
            drop(place);
            fitted = canvas;
            &fitted
        };
        let factor = match self.head {
            Head::Rows { .. } | Head::Finished => 1.0 / 255.0,
            Head::Sides { .. } | Head::SizeOffset { .. } => 1.0,
        };
        let blob = dnn::blob_from_image(picture, factor, size, Scalar::default(), false, false, CV_32F)?;
        self.net.set_input(&blob, &self.input, 1.0, Scalar::default())?;
        let mut out: Vector<Mat> = Vector::new();
        self.net.forward(&mut out, &Vector::<String>::from_iter(self.outputs.iter().map(String::as_str)))?;
        Ok(out.iter().collect())
    }

    /// Pixels of the input per pixel of the frame.
    fn scale(&self, frame: &Frame) -> f32 {
        (self.size.0 as f32 / frame.width as f32).min(self.size.1 as f32 / frame.height as f32)
    }
}

/// Without the batch.
fn shape(output: &Mat) -> Vec<usize> {
    output.mat_size().iter().skip(1).map(|&n| n as usize).collect()
}

impl Detector for OnnxDetector {
    fn name(&self) -> &str {
        &self.name
    }

    fn detect(
        &mut self,
        frame: &Frame,
        _camera: &CameraConfig,
        found: &mut Vec<Detection>,
    ) -> Result<(), PerceptionError> {
        found.clear();
        let expected = frame.width * frame.height * 3;
        if frame.rgb.len() != expected || expected == 0 {
            return Err(PerceptionError::Size {
                expected: self.size,
                found: (frame.width, frame.height),
                hint: format!("the frame holds {} colour bytes, not {expected}", frame.rgb.len()),
            });
        }
        let failed = |name: &str, e: opencv::Error| PerceptionError::Detector {
            name: name.to_string(),
            why: e.message,
        };
        let outputs = self.forward(frame).map_err(|e| failed(&self.name, e))?;
        let shapes: Vec<Vec<usize>> = outputs.iter().map(shape).collect();
        let mut tensors = Vec::with_capacity(outputs.len());
        for ((output, shape), name) in outputs.iter().zip(&shapes).zip(&self.outputs) {
            let values = output.data_typed::<f32>().map_err(|e| failed(&self.name, e))?;
            tensors.push(Tensor { name, shape, values });
        }
        *found = heads::decode(&self.head, &tensors, self.size.0, self.min_score);
        let scale = self.scale(frame);
        for detection in found.iter_mut() {
            detection.bounds = detection.bounds.map(|v| v / scale);
        }
        heads::clip(found, [frame.width as f32, frame.height as f32]);
        Ok(())
    }
}
