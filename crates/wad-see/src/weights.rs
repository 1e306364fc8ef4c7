//! Weights files: safetensors, half precision, with their origin as metadata.

use half::f16;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
#[cfg(feature = "learn")]
use tch::{Kind, TchError, Tensor};
use wad_sim::telemetry;

/// Why weights cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file cannot be read or written.
    #[error("could not {what} `{}`: {source}", path.display())]
    Io {
        /// What failed: a verb.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a weights file.
    #[error("`{}` is not a weights file: {why}; expected safetensors written by `wad-cosim train`", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// A tensor is missing.
    #[error("`{}`: no tensor `{name}`, expected one of shape {expected:?}; the weights are of another network", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The tensor's name.
        name: String,
        /// The shape expected.
        expected: Vec<i64>,
    },
    /// A tensor has another shape than the network's.
    #[error(
        "`{}`: tensor `{name}` has shape {found:?}, expected {expected:?}; the weights are of another network",
        path.display()
    )]
    Shape {
        /// The file.
        path: PathBuf,
        /// The tensor's name.
        name: String,
        /// The shape expected.
        expected: Vec<i64>,
        /// The shape found.
        found: Vec<i64>,
    },
    /// The weights belong to something else, e.g. another encoder.
    #[error(
        "`{}` has {found}, expected {expected}; train again, or name weights that fit",
        path.display()
    )]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// What the file says.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// OpenVINO fails or is missing.
    #[error(transparent)]
    Inference(#[from] crate::inference::InferenceError),
    /// This program cannot compute such a network.
    #[error("this network needs libtorch: build the program with the cargo feature `learn`")]
    NoTorch,
    /// libtorch fails.
    #[cfg(feature = "learn")]
    #[error("libtorch: {0}")]
    Torch(#[from] TchError),
}

/// Key of [`Weights::hash`] in a file's metadata: [`Weights::save`] writes it, and [`Weights::parse`] holds the
/// tensors to it.
pub const HASH: &str = "hash";

/// A tensor as it lies in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// Its type of numbers.
    pub dtype: Dtype,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its numbers, row by row, in the machine's order of bytes (little endian).
    pub data: Vec<u8>,
}

impl Stored {
    /// The numbers, if they are in half or single precision.
    pub fn floats(&self) -> Option<Vec<f32>> {
        match self.dtype {
            Dtype::F16 => Some(self.halves().map(f16::to_f32).collect()),
            Dtype::F32 => {
                let (numbers, _) = self.data.as_chunks::<4>();
                Some(numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
            }
            _ => None,
        }
    }

    /// The numbers of a tensor in half precision.
    pub fn halves(&self) -> impl Iterator<Item = f16> {
        let (numbers, _) = self.data.as_chunks::<2>();
        numbers.iter().map(|bytes| f16::from_le_bytes(*bytes))
    }

    /// A tensor as it will lie in a file.
    ///
    /// # Errors
    /// torch fails, or a file cannot hold such numbers.
    #[cfg(feature = "learn")]
    pub fn of(tensor: &Tensor) -> Result<Self, TchError> {
        let shape = tensor.size().iter().map(|&n| n as usize).collect();
        Ok(Self { dtype: tensor.kind().try_into()?, shape, data: raw(tensor)? })
    }

    /// Named tensors as they will lie in a file.
    ///
    /// # Errors
    /// As [`Stored::of`].
    #[cfg(feature = "learn")]
    pub fn all(tensors: &[(String, Tensor)]) -> Result<Vec<(String, Self)>, TchError> {
        tensors.iter().map(|(name, tensor)| Ok((name.clone(), Self::of(tensor)?))).collect()
    }

    /// The tensor.
    ///
    /// # Errors
    /// torch fails.
    #[cfg(feature = "learn")]
    pub fn tensor(&self) -> Result<Tensor, TchError> {
        let shape: Vec<i64> = self.shape.iter().map(|&n| n as i64).collect();
        Tensor::f_from_data_size(&self.data, &shape, self.dtype.try_into()?)
    }
}

/// Named tensors and metadata.
#[derive(Debug)]
pub struct Weights {
    /// The file that they are from, for messages.
    pub path: PathBuf,
    /// The tensors, by name.
    pub tensors: Vec<(String, Stored)>,
    /// The weights' origin, by key.
    pub metadata: HashMap<String, String>,
}

impl Weights {
    /// Reads a file's bytes; `path` is for messages.
    ///
    /// # Errors
    /// They are not in the safetensors format, hold numbers that are not finite, or were changed since they were
    /// saved.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, WeightsError> {
        let format =
            |e: &dyn std::fmt::Display| WeightsError::Format { path: path.to_path_buf(), why: e.to_string() };
        let file = SafeTensors::deserialize(bytes).map_err(|e| format(&format!("{e:?}")))?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| format(&format!("{e:?}")))?;
        let mut tensors = Vec::new();
        for (name, view) in file.tensors() {
            let (shape, data) = (view.shape().to_vec(), view.data().to_vec());
            let tensor = Stored { dtype: view.dtype(), shape, data };
            let is_finite = match tensor.dtype {
                Dtype::F16 => tensor.halves().all(f16::is_finite),
                _ => tensor.floats().is_none_or(|numbers| numbers.iter().all(|number| number.is_finite())),
            };
            if !is_finite {
                return Err(format(&format!("tensor `{name}` has values that are not finite")));
            }
            tensors.push((name, tensor));
        }
        let metadata = header.metadata().clone().unwrap_or_default();
        let weights = Self { path: path.to_path_buf(), tensors, metadata };
        match weights.metadata.get(HASH) {
            Some(said) if *said != weights.hash() => {
                Err(format(&"its tensors do not have the hash that it says, so it is damaged"))
            }
            _ => Ok(weights),
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not in the safetensors format.
    pub fn load(path: &Path) -> Result<Self, WeightsError> {
        let io = |source| WeightsError::Io { what: "read", path: path.to_path_buf(), source };
        let weights = Self::parse(path, &std::fs::read(path).map_err(io)?)?;
        if !weights.metadata.contains_key(HASH) {
            tracing::warn!("`{}` holds no hash: damage to it goes unnoticed", path.display());
        }
        Ok(weights)
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), WeightsError> {
        let format = |e: &dyn std::fmt::Debug| WeightsError::Format {
            path: path.to_path_buf(),
            why: format!("{e:?}"),
        };
        let mut views = Vec::new();
        for (name, tensor) in &self.tensors {
            let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.data);
            views.push((name.as_str(), view.map_err(|e| format(&e))?));
        }
        let mut metadata = self.metadata.clone();
        metadata.insert(HASH.to_string(), self.hash());
        let file = safetensors::serialize(views, &Some(metadata)).map_err(|e| format(&e))?;
        telemetry::write_whole(path, &file).map_err(|e| WeightsError::Io {
            what: "write",
            path: e.path,
            source: e.source,
        })
    }

    /// The tensor of a name and shape, as it lies in the file.
    ///
    /// # Errors
    /// There is none, or it has another shape.
    pub fn stored(&self, name: &str, shape: &[i64]) -> Result<&Stored, WeightsError> {
        let path = || self.path.clone();
        let Some((_, tensor)) = self.tensors.iter().find(|(n, _)| n == name) else {
            let (name, expected) = (name.to_string(), shape.to_vec());
            return Err(WeightsError::Missing { path: path(), name, expected });
        };
        let found: Vec<i64> = tensor.shape.iter().map(|&n| n as i64).collect();
        if found != shape {
            let (name, expected) = (name.to_string(), shape.to_vec());
            return Err(WeightsError::Shape { path: path(), name, expected, found });
        }
        Ok(tensor)
    }

    /// The numbers of the tensor of a name and shape.
    ///
    /// # Errors
    /// There is none, it has another shape, or numbers of another type.
    pub fn floats(&self, name: &str, shape: &[i64]) -> Result<Vec<f32>, WeightsError> {
        let tensor = self.stored(name, shape)?;
        tensor.floats().ok_or_else(|| WeightsError::Format {
            path: self.path.clone(),
            why: format!("tensor `{name}` has numbers of type {:?}, expected F16 or F32", tensor.dtype),
        })
    }

    /// The tensor of a name and shape.
    ///
    /// # Errors
    /// There is none, or it has another shape.
    #[cfg(feature = "learn")]
    pub fn get(&self, name: &str, shape: &[i64]) -> Result<Tensor, WeightsError> {
        Ok(self.stored(name, shape)?.tensor()?)
    }

    /// Identifies the tensors: names, types, shapes and contents, in the order of the names.
    pub fn hash(&self) -> String {
        let mut sorted: Vec<&(String, Stored)> = self.tensors.iter().collect();
        sorted.sort_by(|a, b| a.0.cmp(&b.0));
        // FNV-1a over 8 bytes at a time: stable over releases, fast enough for 20 MB.
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        let mut add = |bytes: &[u8]| {
            for chunk in bytes.chunks(8) {
                let mut word = [0; 8];
                word[..chunk.len()].copy_from_slice(chunk);
                hash = (hash ^ u64::from_le_bytes(word)).wrapping_mul(0x0100_0000_01b3).rotate_left(29);
            }
        };
        for (name, tensor) in sorted {
            // By torch's names.
            let kind = match tensor.dtype {
                Dtype::F16 => "Half".to_string(),
                Dtype::F32 => "Float".to_string(),
                Dtype::F64 => "Double".to_string(),
                Dtype::I64 => "Int64".to_string(),
                Dtype::U8 => "Uint8".to_string(),
                other => format!("{other:?}"),
            };
            add(format!("{name} {kind} {:?}", tensor.shape).as_bytes());
            add(&tensor.data);
        }
        format!("{hash:016x}")
    }
}

/// A tensor's bytes.
#[cfg(feature = "learn")]
fn raw(tensor: &Tensor) -> Result<Vec<u8>, TchError> {
    let tensor = tensor.f_to_device(tch::Device::Cpu)?.f_contiguous()?;
    let count = tensor.numel();
    let mut bytes = vec![0; count * tensor.kind().elt_size_in_bytes()];
    tensor.f_copy_data_u8(&mut bytes, count)?;
    Ok(bytes)
}

/// Half precision on the processor.
///
/// # Errors
/// torch fails.
#[cfg(feature = "learn")]
pub fn half(tensor: &Tensor) -> Result<Tensor, TchError> {
    tensor.f_detach()?.f_to_device(tch::Device::Cpu)?.f_to_kind(Kind::Half)
}

#[cfg(all(test, feature = "learn"))]
mod tests {
    use super::*;

    fn saved(values: &[f32]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        let tensors = vec![("w".to_string(), Stored::of(&Tensor::from_slice(values)).unwrap())];
        Weights { path: path.clone(), tensors, metadata: HashMap::new() }.save(&path).unwrap();
        (folder, path)
    }

    #[test]
    fn a_changed_bit_is_noticed() {
        let (_folder, path) = saved(&[1.0, 2.0, 3.0]);
        Weights::load(&path).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        let error = Weights::load(&path).unwrap_err().to_string();
        assert!(error.contains("it is damaged"), "{error}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        for value in [f32::NAN, f32::INFINITY] {
            let (_folder, path) = saved(&[1.0, value]);
            let error = Weights::load(&path).unwrap_err().to_string();
            assert!(error.contains("`w` has values that are not finite"), "{error}");
        }
    }
}
