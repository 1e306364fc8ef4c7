//! Event files for TensorBoard: TFRecord framing, one scalar per event.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Writes scalars into a folder's event file.
#[derive(Debug)]
pub struct EventWriter {
    path: PathBuf,
    file: BufWriter<File>,
}

impl EventWriter {
    /// Begins a new event file in `folder`. TensorBoard reads all files of a folder in order, so a resumed
    /// run adds another file. Where `resumed` is the step of its checkpoint, TensorBoard forgets what the earlier files
    /// say of later steps, as it does for PyTorch's `purge_step`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(folder: &Path, resumed: Option<u64>) -> std::io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let now = seconds();
        let mut copy = 0;
        let path = loop {
            let name = format!("events.out.tfevents.{:010}.{copy}.wad-cosim", now as u64);
            let path = folder.join(name);
            if !path.exists() {
                break path;
            }
            copy += 1;
        };
        let mut writer = Self { file: BufWriter::new(File::create(&path)?), path };
        let mut event = Vec::new();
        double_field(&mut event, 1, now);
        bytes_field(&mut event, 3, b"brain.Event:2");
        writer.record(&event)?;
        if let Some(step) = resumed {
            // SessionLog { status: START }
            writer.event(step + 1, 7, &[0x08, 0x01])?;
        }
        writer.flush()?;
        Ok(writer)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends a scalar, e.g. `losses/train` at step 100.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn scalar(&mut self, tag: &str, step: u64, value: f64) -> std::io::Result<()> {
        let mut pair = Vec::new();
        bytes_field(&mut pair, 1, tag.as_bytes());
        key(&mut pair, 2, 5);
        pair.extend((value as f32).to_le_bytes());
        let mut summary = Vec::new();
        bytes_field(&mut summary, 1, &pair);
        self.event(step, 5, &summary)
    }

    /// Appends an event at `step` whose protobuf field `what` holds `bytes`.
    fn event(&mut self, step: u64, what: u64, bytes: &[u8]) -> std::io::Result<()> {
        let mut event = Vec::new();
        double_field(&mut event, 1, seconds());
        key(&mut event, 2, 0);
        varint(&mut event, step);
        bytes_field(&mut event, what, bytes);
        self.record(&event)
    }

    /// Flushes the buffer.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }

    fn record(&mut self, data: &[u8]) -> std::io::Result<()> {
        let length = (data.len() as u64).to_le_bytes();
        self.file.write_all(&length)?;
        self.file.write_all(&masked_crc(&length).to_le_bytes())?;
        self.file.write_all(data)?;
        self.file.write_all(&masked_crc(data).to_le_bytes())
    }
}

fn seconds() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

/// protobuf's field key.
fn key(out: &mut Vec<u8>, field: u64, wire_type: u64) {
    varint(out, field << 3 | wire_type);
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn bytes_field(out: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    key(out, field, 2);
    varint(out, bytes.len() as u64);
    out.extend(bytes);
}

fn double_field(out: &mut Vec<u8>, field: u64, value: f64) {
    key(out, field, 1);
    out.extend(value.to_le_bytes());
}

/// TFRecord's masked CRC-32C.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// CRC-32 with Castagnoli's polynomial, bit by bit: events are short.
fn crc32c(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0x82f6_3b78 & (crc & 1).wrapping_neg()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc32c_of_the_standards_check_string() {
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
    }

    /// The events of a file, whose framing is checked.
    fn read(writer: &EventWriter) -> Vec<Vec<u8>> {
        let bytes = std::fs::read(writer.path()).unwrap();
        let mut at = 0;
        let mut events = Vec::new();
        while at < bytes.len() {
            let length = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
            let crc = u32::from_le_bytes(bytes[at + 8..at + 12].try_into().unwrap());
            assert_eq!(crc, masked_crc(&bytes[at..at + 8]));
            let data = &bytes[at + 12..at + 12 + length];
            let crc = u32::from_le_bytes(bytes[at + 12 + length..at + 16 + length].try_into().unwrap());
            assert_eq!(crc, masked_crc(data));
            events.push(data.to_vec());
            at += 16 + length;
        }
        events
    }

    #[test]
    fn an_event_is_framed_and_holds_its_scalar() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(folder.path(), None).unwrap();
        writer.scalar("losses/train", 300, 0.25).unwrap();
        writer.flush().unwrap();
        let events = read(&writer);
        assert_eq!(events.len(), 2);
        let data = &events[1];
        // Step 300 as a varint after key 0x10; the value 0.25 at the end.
        assert_eq!(&data[9..12], &[0x10, 0xac, 0x02]);
        assert_eq!(&data[data.len() - 4..], &0.25_f32.to_le_bytes());
    }

    #[test]
    fn a_resumed_run_says_from_which_step_on_it_begins_again() {
        let folder = tempfile::tempdir().unwrap();
        let events = read(&EventWriter::create(folder.path(), Some(299)).unwrap());
        assert_eq!(events.len(), 2);
        // Step 300, and session_log (field 7) with status (field 1) START (1).
        assert_eq!(&events[1][9..], &[0x10, 0xac, 0x02, 0x3a, 0x02, 0x08, 0x01]);
    }
}
