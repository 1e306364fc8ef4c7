//! Pictures inside shards: PNG for transformed images, JPEG (with OpenCV) or PNG for the camera's.

use super::error::DatasetError;
use serde::{Deserialize, Serialize};

/// The format of camera pictures in a shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraCodec {
    /// Lossless.
    Png,
    /// Quality 95.
    Jpeg,
}

impl CameraCodec {
    /// JPEG if this build has OpenCV, else PNG.
    pub fn best() -> Self {
        if cfg!(feature = "vision") { Self::Jpeg } else { Self::Png }
    }

    /// Encodes an RGB picture.
    ///
    /// # Errors
    /// This build has no JPEG, or the picture cannot be encoded.
    pub fn encode(self, rgb: &[u8], width: usize, height: usize) -> Result<Vec<u8>, DatasetError> {
        match self {
            Self::Png => encode_png(rgb, width as u32, height as u32),
            Self::Jpeg => jpeg::encode(rgb, width, height),
        }
    }
}

/// A camera picture as RGB bytes.
///
/// # Errors
/// It is damaged, has another size, or is a JPEG and this build has no OpenCV.
pub fn decode_camera(
    codec: CameraCodec,
    bytes: &[u8],
    width: usize,
    height: usize,
) -> Result<Vec<u8>, DatasetError> {
    match codec {
        CameraCodec::Png => {
            let mut rgb = vec![0; width * height * 3];
            decode_png(bytes, width as u32, height as u32, &mut rgb)?;
            Ok(rgb)
        }
        CameraCodec::Jpeg => jpeg::decode(bytes, width, height),
    }
}

/// RGB bytes as a PNG, compressed fast.
///
/// # Errors
/// The bytes are not those of a picture of that size.
pub fn encode_png(rgb: &[u8], width: u32, height: u32) -> Result<Vec<u8>, DatasetError> {
    let fail = |error: png::EncodingError| DatasetError::Image(error.to_string());
    let mut bytes = Vec::with_capacity(rgb.len() / 2);
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(fail)?;
    writer.write_image_data(rgb).map_err(fail)?;
    writer.finish().map_err(fail)?;
    Ok(bytes)
}

/// A PNG of exactly that size into `rgb`.
///
/// # Errors
/// It is damaged, or of another size or kind.
pub fn decode_png(bytes: &[u8], width: u32, height: u32, rgb: &mut [u8]) -> Result<(), DatasetError> {
    let fail = |error: png::DecodingError| DatasetError::Image(error.to_string());
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().map_err(fail)?;
    let info = reader.info();
    let found = (info.width, info.height);
    let expected = width as usize * height as usize * 3;
    if found != (width, height) || info.color_type != png::ColorType::Rgb || rgb.len() != expected {
        return Err(DatasetError::Image(format!(
            "expected an RGB picture of {width}x{height}, found {:?} of {}x{}",
            info.color_type, found.0, found.1
        )));
    }
    reader.next_frame(rgb).map_err(fail)?;
    Ok(())
}

#[cfg(feature = "vision")]
mod jpeg {
    use super::DatasetError;
    use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Vector};
    use opencv::{imgcodecs, imgproc};

    fn fail(error: opencv::Error) -> DatasetError {
        DatasetError::Image(error.to_string())
    }

    pub fn encode(rgb: &[u8], width: usize, height: usize) -> Result<Vec<u8>, DatasetError> {
        if rgb.len() != width * height * 3 {
            return Err(DatasetError::Image(format!(
                "expected {} bytes for {width}x{height}, found {}",
                width * height * 3,
                rgb.len()
            )));
        }
        let flat = Mat::from_slice(rgb).map_err(fail)?;
        let picture = flat.reshape(3, height as i32).map_err(fail)?;
        let mut bgr = Mat::default();
        imgproc::cvt_color_def(&picture, &mut bgr, imgproc::COLOR_RGB2BGR).map_err(fail)?;
        let mut bytes = Vector::<u8>::new();
        let quality = Vector::<i32>::from_slice(&[imgcodecs::IMWRITE_JPEG_QUALITY, 95]);
        imgcodecs::imencode(".jpg", &bgr, &mut bytes, &quality).map_err(fail)?;
        Ok(bytes.as_slice().to_vec())
    }

    pub fn decode(bytes: &[u8], width: usize, height: usize) -> Result<Vec<u8>, DatasetError> {
        let data = Vector::<u8>::from_slice(bytes);
        let bgr = imgcodecs::imdecode(&data, imgcodecs::IMREAD_COLOR).map_err(fail)?;
        if (bgr.cols(), bgr.rows()) != (width as i32, height as i32) {
            return Err(DatasetError::Image(format!(
                "expected a JPEG of {width}x{height}, found {}x{}",
                bgr.cols(),
                bgr.rows()
            )));
        }
        let mut rgb = Mat::default();
        imgproc::cvt_color_def(&bgr, &mut rgb, imgproc::COLOR_BGR2RGB).map_err(fail)?;
        Ok(rgb.data_bytes().map_err(fail)?.to_vec())
    }
}

#[cfg(not(feature = "vision"))]
mod jpeg {
    use super::DatasetError;

    fn missing() -> DatasetError {
        DatasetError::Image(
            "a JPEG needs OpenCV, and this build has none; build with the feature `vision`".to_string(),
        )
    }

    pub fn encode(_: &[u8], _: usize, _: usize) -> Result<Vec<u8>, DatasetError> {
        Err(missing())
    }

    pub fn decode(_: &[u8], _: usize, _: usize) -> Result<Vec<u8>, DatasetError> {
        Err(missing())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_keeps_every_byte_and_refuses_another_size() {
        let rgb: Vec<u8> = (0..8 * 4 * 3).map(|i| (i * 7) as u8).collect();
        let bytes = encode_png(&rgb, 8, 4).unwrap();
        let mut back = vec![0; rgb.len()];
        decode_png(&bytes, 8, 4, &mut back).unwrap();
        assert_eq!(back, rgb);
        let error = decode_png(&bytes, 4, 8, &mut back).unwrap_err().to_string();
        assert!(error.contains("4x8") && error.contains("8x4"), "{error}");
    }

    #[cfg(feature = "vision")]
    #[test]
    fn jpeg_keeps_the_channels_in_order() {
        let rgb: Vec<u8> = [200, 100, 30].repeat(16 * 16);
        let bytes = CameraCodec::Jpeg.encode(&rgb, 16, 16).unwrap();
        let back = decode_camera(CameraCodec::Jpeg, &bytes, 16, 16).unwrap();
        assert!(back.iter().zip(&rgb).all(|(a, b)| a.abs_diff(*b) < 4), "{:?}", &back[..3]);
    }
}
