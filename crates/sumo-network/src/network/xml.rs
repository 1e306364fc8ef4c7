//! SUMO's XML files: reading them whole, plain or gzipped, and walking their elements.

use super::error::NetworkError;
use quick_xml::errors::SyntaxError;
use quick_xml::events::{BytesStart, Event};
use std::borrow::Cow;
use std::io::Read;
use std::path::Path;

/// A file that unpacks to more than this is refused (bytes).
const LARGEST: u64 = 4 << 30;

/// Reads a whole file, plain or gzipped; gzip is found by its magic bytes.
///
/// # Errors
/// It cannot be read, is damaged gzip, or unpacks to more than 4 GiB.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, NetworkError> {
    let bytes = std::fs::read(path).map_err(|source| NetworkError::Io { path: path.to_owned(), source })?;
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(bytes);
    }
    unpack(&bytes, LARGEST).map_err(|source| NetworkError::Compressed { path: path.to_owned(), source })
}

fn unpack(packed: &[u8], most: u64) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(packed.len().saturating_mul(8));
    flate2::read::MultiGzDecoder::new(packed).take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(std::io::Error::other(format!("it unpacks to more than {most} bytes")));
    }
    Ok(bytes)
}

/// The same as text. What is not UTF-8 is read as Latin-1.
///
/// # Errors
/// As [`read_bytes`].
pub fn read_text(path: &Path) -> Result<String, NetworkError> {
    Ok(match String::from_utf8(read_bytes(path)?) {
        Ok(text) => text,
        Err(error) => error.into_bytes().iter().map(|&b| b as char).collect(),
    })
}

/// A step of the walk through a document.
pub(super) enum Step<'a> {
    /// An element begins.
    Open(Element<'a>),
    /// An element has ended.
    Close,
}

/// Walks a document's elements in order.
pub(super) struct Walk<'a> {
    path: &'a Path,
    text: &'a str,
    reader: quick_xml::Reader<&'a [u8]>,
    open: Vec<String>,
    pending_close: bool,
}

impl<'a> Walk<'a> {
    /// A walk over `text`, which came from `path`.
    pub fn new(path: &'a Path, text: &'a str) -> Self {
        // A byte order mark is not part of the XML.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut reader = quick_xml::Reader::from_str(text);
        reader.config_mut().allow_dangling_amp = true;
        Self { path, text, reader, open: Vec::new(), pending_close: false }
    }

    /// The next step; None at the document's proper end.
    pub fn next(&mut self) -> Result<Option<Step<'a>>, NetworkError> {
        if std::mem::take(&mut self.pending_close) {
            return Ok(Some(Step::Close));
        }
        loop {
            match self.reader.read_event() {
                Ok(Event::Start(tag)) => {
                    let element = self.element(tag);
                    self.open.push(element.name().to_owned());
                    return Ok(Some(Step::Open(element)));
                }
                Ok(Event::Empty(tag)) => {
                    self.pending_close = true;
                    return Ok(Some(Step::Open(self.element(tag))));
                }
                Ok(Event::End(_)) => {
                    self.open.pop();
                    return Ok(Some(Step::Close));
                }
                Ok(Event::Eof) => {
                    return match self.open.pop() {
                        None => Ok(None),
                        Some(element) => Err(self.truncated(element)),
                    };
                }
                Ok(_) => {}
                Err(error) => {
                    // A tag, comment or string that the end of the file cuts off.
                    if let (quick_xml::Error::Syntax(kind), Some(element)) = (&error, self.open.last())
                        && *kind != SyntaxError::InvalidBangMarkup
                    {
                        return Err(self.truncated(element.clone()));
                    }
                    return Err(NetworkError::Xml {
                        path: self.path.to_owned(),
                        line: self.line_of(self.reader.error_position()),
                        message: error.to_string(),
                    });
                }
            }
        }
    }

    fn element(&self, tag: BytesStart<'a>) -> Element<'a> {
        Element { tag, depth: self.open.len(), position: self.reader.buffer_position() }
    }

    fn truncated(&self, element: String) -> NetworkError {
        let line = self.line_of(self.reader.buffer_position());
        NetworkError::Truncated { path: self.path.to_owned(), line, element }
    }

    /// The line of a byte position, from 1.
    pub fn line_of(&self, position: u64) -> usize {
        let end = usize::try_from(position).map_or(self.text.len(), |p| p.min(self.text.len()));
        1 + self.text.as_bytes()[..end].iter().filter(|&&b| b == b'\n').count()
    }
}

/// An element's name and attributes.
pub(super) struct Element<'a> {
    tag: BytesStart<'a>,
    /// How many elements it lies in.
    pub depth: usize,
    /// Byte position of its end, for [`Walk::line_of`].
    pub position: u64,
}

impl Element<'_> {
    /// The element's name.
    pub fn name(&self) -> &str {
        self.tag.name().0
    }

    /// The values of the attributes with these names, in their order. A malformed attribute ends the
    /// list: what follows it counts as missing.
    pub fn read<const N: usize>(&self, names: [&str; N]) -> [Option<Cow<'_, str>>; N] {
        let mut values = [const { None }; N];
        let mut attributes = self.tag.attributes();
        for attribute in attributes.with_checks(false).flatten() {
            if let Some(i) = names.iter().position(|&n| n == attribute.key.0)
                && values[i].is_none()
            {
                values[i] = Some(unescaped(attribute.value));
            }
        }
        values
    }
}

/// The value with its entities resolved; left as it is where they are unknown.
fn unescaped(value: Cow<'_, str>) -> Cow<'_, str> {
    if value.contains('&')
        && let Ok(plain) = quick_xml::escape::unescape(&value)
    {
        return Cow::Owned(plain.into_owned());
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn what_unpacks_to_too_much_is_refused_and_not_cut() {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(b"<net/>").unwrap();
        let packed = encoder.finish().unwrap();
        assert_eq!(unpack(&packed, 6).unwrap(), b"<net/>");
        let error = unpack(&packed, 5).unwrap_err().to_string();
        assert_eq!(error, "it unpacks to more than 5 bytes");
    }
}
