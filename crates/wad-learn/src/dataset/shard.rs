//! One file of frames: header, records, trailer. Each record is checked by its CRC.
//!
//! ```text
//! "WADSHARD" u32 header length, header JSON
//! per frame: u32 payload length, u32 CRC-32 of the payload,
//!            payload = u32 n, n bytes JSON, u32 m, m bytes PNG (transformed), rest: camera picture
//! u32 0xffff_ffff, u32 number of frames
//! ```
//!
//! All numbers little-endian. A file without its trailer is torn.

use super::error::DatasetError;
use super::image_codec::{CameraCodec, decode_png, encode_png};
use super::plan::Segment;
use super::record::{Frame, FrameRecord};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use wad_see::perception::{TRANSFORMED_SIZE, TransformedImage};

const MAGIC: &[u8; 8] = b"WADSHARD";
const END: u32 = u32::MAX;
/// Longest record (bytes); a longer length is damaged.
const LONGEST: u32 = 64 << 20;

/// The header of a shard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShardHeader {
    /// Version of the format.
    pub version: u64,
    /// The segment that these frames come from.
    pub segment: Segment,
    /// [`wad_camera::CameraConfig::hash`].
    pub camera: String,
    /// The format of camera pictures; None: they are not kept.
    pub camera_codec: Option<CameraCodec>,
}

/// Writes a shard to a temporary file and renames it when it is complete.
pub struct ShardWriter {
    path: PathBuf,
    staging: PathBuf,
    file: Option<BufWriter<File>>,
    frames: u32,
    buffer: Vec<u8>,
}

impl ShardWriter {
    /// Begins the shard of `path`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: &Path, header: &ShardHeader) -> Result<Self, DatasetError> {
        let staging = path.with_extension("part");
        let file = File::create(&staging).map_err(DatasetError::io("write", &staging))?;
        let mut writer = Self {
            path: path.to_path_buf(),
            staging,
            file: Some(BufWriter::with_capacity(1 << 18, file)),
            frames: 0,
            buffer: Vec::new(),
        };
        let text = serde_json::to_vec(header).map_err(|e| DatasetError::io("write", path)(e.into()))?;
        writer.put(MAGIC)?;
        writer.put(&(text.len() as u32).to_le_bytes())?;
        writer.put(&text)?;
        Ok(writer)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), DatasetError> {
        match &mut self.file {
            Some(file) => file.write_all(bytes).map_err(DatasetError::io("write", &self.staging)),
            None => Ok(()),
        }
    }

    /// Frames so far.
    pub fn frames(&self) -> usize {
        self.frames as usize
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// The disk is full, or the file cannot be written.
    pub fn add(&mut self, frame: &Frame) -> Result<(), DatasetError> {
        let path = self.path.clone();
        let text =
            serde_json::to_vec(&frame.record).map_err(|e| DatasetError::io("write", path)(e.into()))?;
        let size = TRANSFORMED_SIZE as u32;
        let image = encode_png(frame.transformed.bytes(), size, size)?;
        let mut payload = std::mem::take(&mut self.buffer);
        payload.clear();
        for part in [&text, &image] {
            payload.extend((part.len() as u32).to_le_bytes());
            payload.extend(part.as_slice());
        }
        payload.extend(&frame.camera);
        self.put(&(payload.len() as u32).to_le_bytes())?;
        self.put(&crc32fast::hash(&payload).to_le_bytes())?;
        self.put(&payload)?;
        self.buffer = payload;
        self.frames += 1;
        Ok(())
    }

    /// Writes the trailer and moves the file to its place.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn finish(mut self) -> Result<usize, DatasetError> {
        let put = self.put_in_place();
        if put.is_err() {
            // If the file is closed already, dropping keeps it.
            let _ = std::fs::remove_file(&self.staging);
        }
        put.map(|()| self.frames as usize)
    }

    fn put_in_place(&mut self) -> Result<(), DatasetError> {
        self.put(&END.to_le_bytes())?;
        self.put(&self.frames.to_le_bytes())?;
        if let Some(file) = self.file.take() {
            let failed = |error: std::io::Error| DatasetError::io("write", &self.staging)(error);
            let file = file.into_inner().map_err(|e| failed(e.into_error()))?;
            file.sync_data().map_err(failed)?;
        }
        std::fs::rename(&self.staging, &self.path).map_err(DatasetError::io("write", &self.path))
    }
}

impl Drop for ShardWriter {
    /// Removes an unfinished file.
    fn drop(&mut self) {
        if self.file.take().is_some() {
            let _ = std::fs::remove_file(&self.staging);
        }
    }
}

/// The place of a frame's camera picture, to be read when needed: a dataset larger than the memory
/// can be trained on. It holds no open file.
#[derive(Clone, Debug)]
pub struct CameraPlace {
    path: Arc<Path>,
    codec: CameraCodec,
    /// From the file's begin (bytes).
    offset: u64,
    length: usize,
    crc: u32,
}

impl CameraPlace {
    /// The picture's format.
    pub fn codec(&self) -> CameraCodec {
        self.codec
    }

    /// The picture's encoded bytes.
    ///
    /// # Errors
    /// The file was removed or changed since the place was found.
    pub fn read(&self) -> Result<Vec<u8>, DatasetError> {
        let io = DatasetError::io("read", &*self.path);
        let mut bytes = vec![0; self.length];
        File::open(&self.path)
            .and_then(|mut file| {
                file.seek(SeekFrom::Start(self.offset))?;
                file.read_exact(&mut bytes)
            })
            .map_err(io)?;
        if crc32fast::hash(&bytes) != self.crc {
            let why = format!("the picture at byte {} changed while the shard was in use", self.offset);
            return Err(DatasetError::Torn { path: self.path.to_path_buf(), why });
        }
        Ok(bytes)
    }
}

/// Reads a shard frame by frame.
pub struct ShardReader {
    path: Arc<Path>,
    file: BufReader<File>,
    header: ShardHeader,
    frames: usize,
    read: usize,
    /// Where the next frame begins (bytes).
    at: u64,
    /// Where the trailer begins (bytes).
    end: u64,
    payload: Vec<u8>,
}

impl ShardReader {
    /// Opens a complete shard.
    ///
    /// # Errors
    /// The file is torn, is not a shard, or has another version.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        let torn = |why: &str| DatasetError::Torn { path: path.to_path_buf(), why: why.to_string() };
        let io = |error| DatasetError::io("read", path)(error);
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut file = BufReader::with_capacity(1 << 18, file);
        let mut magic = [0; 12];
        file.read_exact(&mut magic).map_err(|_| torn("it ends within its header"))?;
        if &magic[..8] != MAGIC {
            return Err(torn("its first bytes are not a shard's"));
        }
        let size = u32::from_le_bytes([magic[8], magic[9], magic[10], magic[11]]);
        if u64::from(size) > length {
            return Err(torn("it ends within its header"));
        }
        let mut text = vec![0; size as usize];
        file.read_exact(&mut text).map_err(|_| torn("it ends within its header"))?;
        let value: serde_json::Value =
            serde_json::from_slice(&text).map_err(|e| torn(&format!("its header is damaged ({e})")))?;
        let found = value.get("version").and_then(serde_json::Value::as_u64).unwrap_or(0);
        if found != super::FORMAT_VERSION {
            let expected = super::FORMAT_VERSION;
            return Err(DatasetError::Version { path: path.to_path_buf(), found, expected });
        }
        let header: ShardHeader =
            serde_json::from_value(value).map_err(|e| torn(&format!("its header is damaged ({e})")))?;
        let begin = file.stream_position().map_err(io)?;
        let mut trailer = [0; 8];
        file.seek(SeekFrom::End(-8)).map_err(io)?;
        file.read_exact(&mut trailer).map_err(io)?;
        if length < begin + 8 || trailer[..4] != END.to_le_bytes() {
            return Err(torn("it ends before its last frame"));
        }
        let frames = u32::from_le_bytes([trailer[4], trailer[5], trailer[6], trailer[7]]) as usize;
        // Each frame has a length and a checksum at the least.
        if frames as u64 > (length - begin - 8) / 8 {
            return Err(torn(&format!("its last bytes claim {frames} frames, more than it has room for")));
        }
        file.seek(SeekFrom::Start(begin)).map_err(io)?;
        Ok(Self {
            path: path.into(),
            file,
            header,
            frames,
            read: 0,
            at: begin,
            end: length - 8,
            payload: Vec::new(),
        })
    }

    /// The header.
    pub fn header(&self) -> &ShardHeader {
        &self.header
    }

    /// Frames in it.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Reads all frames, to the shard's last byte.
    ///
    /// # Errors
    /// One is damaged.
    pub fn verify(mut self) -> Result<(), DatasetError> {
        while self.next_parts()?.is_some() {}
        if self.at == self.end {
            return Ok(());
        }
        let why = format!("its last bytes claim {} frames, and it has more", self.frames);
        Err(DatasetError::Torn { path: self.path.to_path_buf(), why })
    }

    /// The next frame's parts: JSON, PNG, camera picture. None at the end.
    fn next_parts(&mut self) -> Result<Option<[&[u8]; 3]>, DatasetError> {
        if self.read == self.frames {
            return Ok(None);
        }
        let torn = |read: usize, path: &Path| DatasetError::Torn {
            path: path.to_path_buf(),
            why: format!("frame {read} is damaged"),
        };
        let mut head = [0; 8];
        self.file.read_exact(&mut head).map_err(|_| torn(self.read, &self.path))?;
        let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]);
        let crc = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
        // Before memory is reserved for it.
        if length > LONGEST || self.at + 8 + u64::from(length) > self.end {
            return Err(torn(self.read, &self.path));
        }
        self.payload.resize(length as usize, 0);
        self.file.read_exact(&mut self.payload).map_err(|_| torn(self.read, &self.path))?;
        if crc32fast::hash(&self.payload) != crc {
            return Err(torn(self.read, &self.path));
        }
        let parts = split(&self.payload).ok_or_else(|| torn(self.read, &self.path))?;
        self.read += 1;
        self.at += u64::from(length) + 8;
        Ok(Some(parts))
    }

    /// The next frame; None at the end.
    ///
    /// # Errors
    /// The frame is damaged.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, DatasetError> {
        let (path, read) = (self.path.clone(), self.read);
        let Some([text, image, camera]) = self.next_parts()? else { return Ok(None) };
        let torn = |why: String| DatasetError::Torn {
            path: path.to_path_buf(),
            why: format!("frame {read}: {why}"),
        };
        let record: FrameRecord = match serde_json::from_slice(text) {
            Ok(record) => record,
            Err(error) => return Err(torn(error.to_string())),
        };
        let mut transformed = TransformedImage::default();
        let size = TRANSFORMED_SIZE as u32;
        decode_png(image, size, size, transformed.bytes_mut())?;
        Ok(Some(Frame { record, transformed, camera: camera.to_vec() }))
    }

    /// The next frame's record and the place of its camera picture; None at the end.
    ///
    /// # Errors
    /// The frame is damaged, or has no camera picture.
    pub fn next_place(&mut self) -> Result<Option<(FrameRecord, CameraPlace)>, DatasetError> {
        let (path, read) = (self.path.clone(), self.read);
        let torn =
            |why: &str| DatasetError::Torn { path: path.to_path_buf(), why: format!("frame {read}: {why}") };
        let codec = self.header.camera_codec;
        let Some([text, _, camera]) = self.next_parts()? else { return Ok(None) };
        let codec = codec.ok_or_else(|| torn("it has no camera picture"))?;
        let record = serde_json::from_slice(text).map_err(|e| torn(&e.to_string()))?;
        let (length, crc) = (camera.len(), crc32fast::hash(camera));
        // The picture is a frame's last part.
        let offset = self.at - length as u64;
        Ok(Some((record, CameraPlace { path, codec, offset, length, crc })))
    }

    /// The next frame's record only; None at the end.
    ///
    /// # Errors
    /// The frame is damaged.
    pub fn next_record(&mut self) -> Result<Option<FrameRecord>, DatasetError> {
        let (path, read) = (self.path.clone(), self.read);
        let Some([text, ..]) = self.next_parts()? else { return Ok(None) };
        serde_json::from_slice(text)
            .map(Some)
            .map_err(|e| DatasetError::Torn { path: path.to_path_buf(), why: format!("frame {read}: {e}") })
    }

    /// Reads only the next frame's transformed image into `bytes` ([`TransformedImage::BYTES`] of them);
    /// false at the end.
    ///
    /// # Errors
    /// The frame is damaged.
    pub fn next_image(&mut self, bytes: &mut [u8]) -> Result<bool, DatasetError> {
        let size = TRANSFORMED_SIZE as u32;
        match self.next_parts()? {
            Some([_, image, _]) => decode_png(image, size, size, bytes).map(|()| true),
            None => Ok(false),
        }
    }
}

fn split(payload: &[u8]) -> Option<[&[u8]; 3]> {
    let part = |bytes| -> Option<(&[u8], &[u8])> {
        let (length, rest): (&[u8; 4], &[u8]) = <[u8]>::split_first_chunk(bytes)?;
        rest.split_at_checked(u32::from_le_bytes(*length) as usize)
    };
    let (text, rest) = part(payload)?;
    let (image, camera) = part(rest)?;
    Some([text, image, camera])
}

#[cfg(test)]
mod tests;
