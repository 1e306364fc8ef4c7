//! The replay buffer on disk, in chunks; a checkpoint writes only the changed ones.
//!
//! A chunk's file name has its place and the buffer's count of entries at its last change
//! (`chunk-3-40960.bin`), and never changes once it is there: checkpoints share files.

use super::places::Place;
use super::replay_buffer::ReplayBuffer;
use half::slice::HalfFloatSliceExt;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::io::{Error, ErrorKind, Result};
use std::path::Path;
use wad_sim::telemetry::write_whole;

/// Entries per chunk.
const CHUNK: usize = 8192;

/// The files of a buffer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplayManifest {
    /// Entries ever written.
    pub written: u64,
    /// Entries that fit into the ring.
    pub capacity: usize,
    /// The files, one per chunk.
    pub chunks: Vec<ChunkFile>,
    /// The places that lead to each termination, oldest first; none in checkpoints of older versions.
    #[serde(default)]
    pub leads: Vec<Vec<u32>>,
}

/// One chunk's file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChunkFile {
    /// The file's name.
    pub file: String,
    /// The file's length (bytes).
    pub bytes: u64,
    /// CRC-32 of the file.
    pub crc: u32,
}

impl ReplayBuffer {
    /// Writes the chunks that `before` does not have yet into `folder`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn save(&self, folder: &Path, before: &ReplayManifest) -> Result<ReplayManifest> {
        std::fs::create_dir_all(folder)?;
        let numbers = |lead: Vec<Place>| lead.into_iter().map(|place| place.0).collect();
        let mut manifest = ReplayManifest {
            written: self.written,
            capacity: self.capacity(),
            chunks: Vec::new(),
            leads: self.leads().into_iter().map(numbers).collect(),
        };
        for chunk in 0..self.len().div_ceil(CHUNK) {
            let file = format!("chunk-{chunk}-{}.bin", self.touched(chunk));
            if let Some(known) = before.chunks.get(chunk).filter(|known| known.file == file) {
                manifest.chunks.push(known.clone());
                continue;
            }
            let data = self.chunk_bytes(chunk);
            write_whole(&folder.join(&file), &data).map_err(|e| e.source)?;
            manifest.chunks.push(ChunkFile { file, bytes: data.len() as u64, crc: crc32fast::hash(&data) });
        }
        Ok(manifest)
    }

    /// Fills an empty buffer of the same capacity.
    ///
    /// # Errors
    /// A file is missing, cut short or damaged, or the buffer is of another size.
    pub fn restore(&mut self, folder: &Path, manifest: &ReplayManifest) -> Result<()> {
        if manifest.capacity != self.capacity() {
            let (expected, found) = (self.capacity(), manifest.capacity);
            return Err(invalid(format!("expected a buffer of {expected} entries, found one of {found}")));
        }
        self.written = manifest.written;
        if manifest.chunks.len() != self.len().div_ceil(CHUNK) {
            return Err(invalid(format!(
                "{} entries are {} chunks, found {}",
                self.len(),
                self.len().div_ceil(CHUNK),
                manifest.chunks.len()
            )));
        }
        for (chunk, known) in manifest.chunks.iter().enumerate() {
            let path = folder.join(&known.file);
            let data = std::fs::read(&path)
                .map_err(|e| Error::new(e.kind(), format!("`{}`: {e}", path.display())))?;
            if data.len() as u64 != known.bytes || crc32fast::hash(&data) != known.crc {
                return Err(invalid(format!(
                    "`{}`: expected {} bytes with checksum {:08x}, found {} bytes with {:08x}",
                    path.display(),
                    known.bytes,
                    known.crc,
                    data.len(),
                    crc32fast::hash(&data)
                )));
            }
            self.take_chunk(chunk, &data)?;
        }
        let places = |lead: &Vec<u32>| lead.iter().copied().map(Place).collect();
        self.index(manifest.leads.iter().map(places).collect());
        Ok(())
    }

    /// How many entries had ever been written when the chunk was last touched.
    fn touched(&self, chunk: usize) -> u64 {
        let capacity = self.capacity() as u64;
        let end = (((chunk + 1) * CHUNK) as u64).min(capacity);
        let (lap, head) = (self.written / capacity, self.written % capacity);
        if head >= end {
            lap * capacity + end
        } else if head > (chunk * CHUNK) as u64 {
            self.written
        } else {
            // Last touched a lap ago.
            lap.saturating_sub(1) * capacity + end
        }
    }

    fn rows(&self, chunk: usize) -> std::ops::Range<usize> {
        chunk * CHUNK..((chunk + 1) * CHUNK).min(self.len())
    }

    fn chunk_bytes(&self, chunk: usize) -> Vec<u8> {
        let rows = self.rows(chunk);
        let (latent, raw, a) = self.widths();
        let mut data = Vec::with_capacity(rows.len() * Self::bytes_per_entry(self.dims) as usize);
        let latents = &self.latents[rows.start * latent..rows.end * latent];
        data.extend(latents.reinterpret_cast().iter().flat_map(|x: &u16| x.to_le_bytes()));
        let mut floats = |values: &[f32]| data.extend(values.iter().flat_map(|x| x.to_le_bytes()));
        floats(&self.raw[rows.start * raw..rows.end * raw]);
        floats(&self.actions[rows.start * a..rows.end * a]);
        floats(&self.shown[rows.start * a..rows.end * a]);
        floats(&self.rewards[rows.clone()]);
        data.extend(self.places[rows.clone()].iter().flat_map(|place| place.0.to_le_bytes()));
        data.extend(&self.flags[rows]);
        data
    }

    fn take_chunk(&mut self, chunk: usize, data: &[u8]) -> Result<()> {
        let rows = self.rows(chunk);
        let (latent, raw, a) = self.widths();
        let n = rows.len();
        if data.len() as u64 != n as u64 * Self::bytes_per_entry(self.dims) {
            return Err(invalid(format!("chunk {chunk}: {} bytes for {n} entries", data.len())));
        }
        let (latents, rest) = data.split_at(2 * n * latent);
        for (x, b) in self.latents[rows.start * latent..].iter_mut().zip(latents.chunks_exact(2)) {
            *x = half::f16::from_bits(u16::from_le_bytes([b[0], b[1]]));
        }
        let fill = |into: &mut [f32], bytes: &[u8]| {
            for (x, b) in into.iter_mut().zip(bytes.chunks_exact(4)) {
                *x = f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            }
        };
        let (raws, rest) = rest.split_at(4 * n * raw);
        let (actions, rest) = rest.split_at(4 * n * a);
        let (shown, rest) = rest.split_at(4 * n * a);
        let (rewards, rest) = rest.split_at(4 * n);
        let (places, flags) = rest.split_at(4 * n);
        fill(&mut self.raw[rows.start * raw..], raws);
        fill(&mut self.actions[rows.start * a..], actions);
        fill(&mut self.shown[rows.start * a..], shown);
        fill(&mut self.rewards[rows.start..], rewards);
        for (place, b) in self.places[rows.start..].iter_mut().zip(places.chunks_exact(4)) {
            *place = Place(u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        }
        self.flags[rows].copy_from_slice(flags);
        Ok(())
    }

    fn widths(&self) -> (usize, usize, usize) {
        (self.dims.latent as usize, self.dims.raw as usize, self.dims.actions as usize)
    }
}

/// Removes the chunks in `folder` that no manifest lists.
///
/// # Errors
/// The folder cannot be read, or a file not removed.
pub fn remove_unused(folder: &Path, used: &[&ReplayManifest]) -> Result<()> {
    let keep: BTreeSet<&str> =
        used.iter().flat_map(|manifest| &manifest.chunks).map(|chunk| chunk.file.as_str()).collect();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        if !keep.contains(entry.file_name().to_string_lossy().as_ref()) {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

fn invalid(why: String) -> Error {
    Error::new(ErrorKind::InvalidData, why)
}

#[cfg(test)]
mod tests {
    use super::super::networks::Dims;
    use super::super::replay_buffer::Segment;
    use super::*;

    const DIMS: Dims = Dims { latent: 3, raw: 2, actions: 3 };

    fn push(buffer: &mut ReplayBuffer, from: usize, n: usize) {
        let value = |k: usize| (from + k) as f32 / 7.0;
        buffer.push(&Segment {
            observations: (0..=n).map(|k| vec![value(k); 5]).collect(),
            actions: (0..n).map(|k| [value(k), 0.5, 1.0]).collect(),
            rewards: (0..n).map(value).collect(),
            terminated: from.is_multiple_of(2),
            truncated: from % 2 == 1,
            shown: (0..n).map(|k| from.is_multiple_of(3).then(|| [value(k), 0.1, 0.2])).collect(),
            places: (0..n).map(|k| Place((from + k) as u32 / 9)).collect(),
            lead: vec![Place(from as u32)],
        });
    }

    fn same(one: &ReplayBuffer, two: &ReplayBuffer) {
        assert_eq!(one.written, two.written);
        assert_eq!(one.latents, two.latents);
        assert_eq!((&one.raw, &one.actions, &one.rewards), (&two.raw, &two.actions, &two.rewards));
        assert_eq!(one.shown, two.shown);
        assert_eq!((&one.flags, &one.places), (&two.flags, &two.places));
        assert_eq!(one.leads(), two.leads());
    }

    #[test]
    fn comes_back_at_every_fill_and_writes_only_what_changed() {
        let folder = tempfile::tempdir().unwrap();
        let mut buffer = ReplayBuffer::new(DIMS, 20_000).unwrap();
        let mut manifest = ReplayManifest::default();
        let (mut at, mut written) = (0, Vec::new());
        for _ in 0..9 {
            for _ in 0..150 {
                push(&mut buffer, at, 40);
                at += 1;
            }
            let before: BTreeSet<String> = manifest.chunks.iter().map(|c| c.file.clone()).collect();
            manifest = buffer.save(folder.path(), &manifest).unwrap();
            remove_unused(folder.path(), &[&manifest]).unwrap();
            written.push(manifest.chunks.iter().filter(|c| !before.contains(&c.file)).count());
            let mut back = ReplayBuffer::new(DIMS, 20_000).unwrap();
            back.restore(folder.path(), &manifest).unwrap();
            same(&buffer, &back);
        }
        assert!(buffer.written > 2 * buffer.capacity() as u64, "the ring went round");
        assert!(written.iter().all(|n| (1..=2).contains(n)), "{written:?} chunks per checkpoint");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), manifest.chunks.len());
    }

    #[test]
    fn a_cut_chunk_and_another_size_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut buffer = ReplayBuffer::new(DIMS, 2000).unwrap();
        push(&mut buffer, 1, 60);
        let manifest = buffer.save(folder.path(), &ReplayManifest::default()).unwrap();
        let other = ReplayBuffer::new(DIMS, 3000).unwrap().restore(folder.path(), &manifest);
        assert!(other.unwrap_err().to_string().contains("expected a buffer of"));
        let path = folder.path().join(&manifest.chunks[0].file);
        let data = std::fs::read(&path).unwrap();
        std::fs::write(&path, &data[..data.len() - 3]).unwrap();
        let error = ReplayBuffer::new(DIMS, 2000).unwrap().restore(folder.path(), &manifest).unwrap_err();
        assert!(error.to_string().contains("checksum"), "{error}");
    }
}
