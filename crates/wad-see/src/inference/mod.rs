//! Fast inference on processors, by OpenVINO: a library that is loaded when a network first asks for it.
//!
//! It needs no libtorch. Whole numbers of 8 bits are its strength: three times as fast as single precision where the
//! processor has VNNI.

pub mod ir;

use ir::Ir;
use openvino::{Core, DeviceType, ElementType, InferRequest, RwPropertyKey, Shape, Tensor};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};
use wad_sim::bundled::cache_dir;

/// The version that `scripts/setup` fetches; any newer one may do as well.
pub const VERSION: &str = "2026.4.1";
/// Names a folder with OpenVINO's libraries, or is `off`.
pub const VARIABLE: &str = "WAD_COSIM_OPENVINO";

/// Why a network does not run.
#[derive(Clone, Debug, thiserror::Error)]
pub enum InferenceError {
    /// The variable says so.
    #[error("OpenVINO is switched off: {VARIABLE} is off")]
    Off,
    /// There is no library.
    #[error(
        "found no OpenVINO in {}: run scripts/setup, or name the folder of libopenvino_c.so with {VARIABLE} (Python's \
         package openvino has it in openvino/libs)",
        looked.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    Missing {
        /// The folders that were looked into.
        looked: Vec<PathBuf>,
    },
    /// It fails.
    #[error("OpenVINO: {0}")]
    Failed(String),
}

fn failed(error: impl std::fmt::Display) -> InferenceError {
    InferenceError::Failed(error.to_string())
}

/// `libopenvino_c.so` or `libopenvino_c.so.2641` in a folder.
fn library(folder: &Path) -> Option<PathBuf> {
    let files = std::fs::read_dir(folder).ok()?;
    files
        .filter_map(|file| Some(file.ok()?.path()))
        .filter(|path| {
            path.file_name()
                .and_then(|name| name.to_str())
                .is_some_and(|name| name.starts_with("libopenvino_c.so"))
        })
        .min()
}

static OWN: OnceLock<PathBuf> = OnceLock::new();

/// Names the folder of the libraries that came with the program, e.g. with a Python package. [`VARIABLE`] still wins.
pub fn set_own(folder: PathBuf) {
    let _ = OWN.set(folder);
}

fn start() -> Result<Core, InferenceError> {
    let folders = match std::env::var_os(VARIABLE) {
        Some(off) if off == "off" => return Err(InferenceError::Off),
        Some(folder) if !folder.is_empty() => vec![PathBuf::from(folder)],
        _ => {
            let cached = cache_dir().map(|cache| cache.join(format!("openvino-{VERSION}")));
            OWN.get().cloned().into_iter().chain(cached).collect()
        }
    };
    let Some(library) = folders.iter().find_map(|folder| library(folder)) else {
        return Err(InferenceError::Missing { looked: folders });
    };
    openvino_sys::library::load_from(library).map_err(failed)?;
    let mut core = Core::new().map_err(failed)?;
    let settings = [
        // A network belongs to one environment, and that has one core.
        (RwPropertyKey::InferenceNumThreads, "1"),
        (RwPropertyKey::NumStreams, "1"),
        // The bridge says where its threads run.
        (RwPropertyKey::HintEnableCpuPinning, "NO"),
        // Else the processor decides which numbers come out.
        (RwPropertyKey::HintInferencePrecision, "f32"),
    ];
    core.set_properties(&DeviceType::CPU, settings).map_err(failed)?;
    Ok(core)
}

/// One per process.
fn core() -> Result<&'static Mutex<Core>, InferenceError> {
    static CORE: OnceLock<Result<Mutex<Core>, InferenceError>> = OnceLock::new();
    CORE.get_or_init(|| start().map(Mutex::new)).as_ref().map_err(Clone::clone)
}

/// Whether OpenVINO is here.
///
/// # Errors
/// Why it is not.
pub fn available() -> Result<(), InferenceError> {
    core().map(|_| ())
}

/// A network that is ready to run on one thread. Its input is bytes, its outputs are numbers of single precision.
pub struct Network {
    request: InferRequest,
    input: Tensor,
    outputs: usize,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Network").field("outputs", &self.outputs).finish_non_exhaustive()
    }
}

impl Network {
    /// Compiles a network whose input has this shape.
    ///
    /// # Errors
    /// There is no OpenVINO, or it refuses the network.
    pub fn new(ir: &Ir, shape: &[usize]) -> Result<Self, InferenceError> {
        let shape: Vec<i64> = shape.iter().map(|&n| n as i64).collect();
        let mut core = core()?.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let shape = Shape::new(&shape).map_err(failed)?;
        let input = Tensor::new(ElementType::U8, &shape).map_err(failed)?;
        let bytes = Shape::new(&[ir.constants().len() as i64]).map_err(failed)?;
        let mut constants = Tensor::new(ElementType::U8, &bytes).map_err(failed)?;
        constants.get_raw_data_mut().map_err(failed)?.copy_from_slice(ir.constants());
        let model = core.read_model_from_buffer(ir.xml().as_bytes(), Some(&constants)).map_err(failed)?;
        let mut compiled = core.compile_model(&model, DeviceType::CPU).map_err(failed)?;
        let mut request = compiled.create_infer_request().map_err(failed)?;
        request.set_input_tensor(&input).map_err(failed)?;
        Ok(Self { request, input, outputs: ir.outputs() })
    }

    /// Runs the network, and gives each output to `read`, by its number.
    ///
    /// # Errors
    /// The input has another size, or OpenVINO fails.
    pub fn run(&mut self, input: &[u8], mut read: impl FnMut(usize, &[f32])) -> Result<(), InferenceError> {
        let into = self.input.get_raw_data_mut().map_err(failed)?;
        if into.len() != input.len() {
            return Err(failed(format!("expected an input of {} bytes, found {}", into.len(), input.len())));
        }
        into.copy_from_slice(input);
        self.request.infer().map_err(failed)?;
        for output in 0..self.outputs {
            let tensor = self.request.get_output_tensor_by_index(output).map_err(failed)?;
            read(output, tensor.get_data::<f32>().map_err(failed)?);
        }
        Ok(())
    }
}
