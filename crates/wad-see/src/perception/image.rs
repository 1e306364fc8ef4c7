//! The small picture that the encoder sees.

use serde::{Deserialize, Serialize};

/// Side of the transformed image (pixels), as in the paper.
pub const TRANSFORMED_SIZE: usize = 128;

/// What an encoder is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageKind {
    /// The paper's transformed image.
    #[default]
    Transformed,
    /// The camera's picture brought to the same size, with nothing painted: what the detections are worth is the difference.
    Plain,
}

impl ImageKind {
    /// Its name in files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Transformed => "transformed",
            Self::Plain => "plain",
        }
    }
}

/// The transformed image: 128 x 128 x 3 sRGB bytes, rows from the top, channels last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TransformedImage(Vec<u8>);

impl TransformedImage {
    /// Bytes in one.
    pub const BYTES: usize = TRANSFORMED_SIZE * TRANSFORMED_SIZE * 3;

    /// An image of exactly [`Self::BYTES`] bytes; None for another number.
    pub fn from_bytes(bytes: Vec<u8>) -> Option<Self> {
        (bytes.len() == Self::BYTES).then_some(Self(bytes))
    }

    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// The bytes, to paint on.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.0
    }
}

impl Default for TransformedImage {
    fn default() -> Self {
        Self(vec![0; Self::BYTES])
    }
}
