//! Bytes to values and back: TraCI's data types, without any socket.
//!
//! All numbers are big-endian. A *typed* value starts with a tag byte; strings
//! and lists carry a 32-bit count. A claimed length alone never
//! allocates: the bytes must be there.

mod values;

/// The tag bytes of TraCI's data types.
pub mod tag {
    /// Longitude and latitude.
    pub const POSITION_LON_LAT: u8 = 0x00;
    /// Position in the plane.
    pub const POSITION_2D: u8 = 0x01;
    /// Longitude, latitude and height.
    pub const POSITION_LON_LAT_ALT: u8 = 0x02;
    /// Position with height.
    pub const POSITION_3D: u8 = 0x03;
    /// Edge, lane position and lane index.
    pub const POSITION_ROADMAP: u8 = 0x04;
    /// A line or area in the plane.
    pub const POLYGON: u8 = 0x06;
    /// 8 bits without sign.
    pub const UBYTE: u8 = 0x07;
    /// 8 bits with sign.
    pub const BYTE: u8 = 0x08;
    /// 32 bits with sign.
    pub const INTEGER: u8 = 0x09;
    /// 64-bit floating-point number.
    pub const DOUBLE: u8 = 0x0B;
    /// Text.
    pub const STRING: u8 = 0x0C;
    /// Texts.
    pub const STRING_LIST: u8 = 0x0E;
    /// Several typed values.
    pub const COMPOUND: u8 = 0x0F;
    /// 64-bit floating-point numbers.
    pub const DOUBLE_LIST: u8 = 0x10;
    /// Red, green, blue, opacity.
    pub const COLOR: u8 = 0x11;
}

/// Compounds nested deeper than this are refused; SUMO's deepest has four levels.
pub(super) const MAX_DEPTH: u8 = 16;

/// Why bytes are not the value that was expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The bytes end within the value.
    #[error("ended at byte {at}: {needed} more bytes expected, {left} found")]
    Truncated {
        /// How many more bytes it needs.
        needed: usize,
        /// How many there are.
        left: usize,
        /// Offset (bytes).
        at: usize,
    },
    /// Another type than asked for.
    #[error(
        "expected {expected} (type 0x{expected_tag:02x}), found {found} (type 0x{found_tag:02x}) at byte {at}"
    )]
    Type {
        /// The type asked for, in words.
        expected: &'static str,
        /// Its TraCI number.
        expected_tag: u8,
        /// The type found, in words.
        found: &'static str,
        /// Its TraCI number.
        found_tag: u8,
        /// Offset (bytes).
        at: usize,
    },
    /// A type number that TraCI does not have.
    #[error("unknown data type 0x{tag:02x} at byte {at}")]
    UnknownType {
        /// The number.
        tag: u8,
        /// Offset (bytes).
        at: usize,
    },
    /// A list of less than nothing.
    #[error("negative count {count} at byte {at}")]
    NegativeCount {
        /// The count.
        count: i32,
        /// Offset (bytes).
        at: usize,
    },
    /// Text that is not UTF-8.
    #[error("text at byte {at} is not UTF-8")]
    Utf8 {
        /// Offset (bytes).
        at: usize,
    },
    /// A compound with too few or too many items.
    #[error("compound with {found} items at byte {at}, {expected} expected")]
    Items {
        /// How many it should have.
        expected: usize,
        /// How many it has.
        found: usize,
        /// Offset (bytes).
        at: usize,
    },
    /// Compounds within compounds beyond the limit.
    #[error("compounds nested more than {MAX_DEPTH} deep at byte {at}")]
    TooDeep {
        /// Offset (bytes).
        at: usize,
    },
    /// Bytes after the value's end.
    #[error("{left} unread bytes after the value that ended at byte {at}")]
    Trailing {
        /// How many.
        left: usize,
        /// Offset of the value's end (bytes).
        at: usize,
    },
}

/// Name of a data type for messages.
pub fn type_name(tag: u8) -> &'static str {
    match tag {
        tag::POSITION_LON_LAT => "lon-lat position",
        tag::POSITION_2D => "2D position",
        tag::POSITION_LON_LAT_ALT => "lon-lat-alt position",
        tag::POSITION_3D => "3D position",
        tag::POSITION_ROADMAP => "road-map position",
        tag::POLYGON => "polygon",
        tag::UBYTE => "unsigned byte",
        tag::BYTE => "byte",
        tag::INTEGER => "integer",
        tag::DOUBLE => "double",
        tag::STRING => "string",
        tag::STRING_LIST => "string list",
        tag::COMPOUND => "compound",
        tag::DOUBLE_LIST => "double list",
        tag::COLOR => "color",
        _ => "unknown type",
    }
}

/// A cursor over a reply. Reads borrow from it.
#[derive(Clone, Copy, Debug)]
pub struct Reader<'a> {
    data: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Starts at the first byte of `data`.
    pub fn new(data: &'a [u8]) -> Self {
        Self { data, at: 0 }
    }

    /// Bytes read so far.
    pub fn position(&self) -> usize {
        self.at
    }

    /// Bytes still unread.
    pub fn remaining(&self) -> usize {
        self.data.len() - self.at
    }

    /// Takes `n` raw bytes.
    pub fn bytes(&mut self, n: usize) -> Result<&'a [u8], DecodeError> {
        let left = self.remaining();
        if n > left {
            return Err(DecodeError::Truncated { needed: n, left, at: self.at });
        }
        let slice = &self.data[self.at..self.at + n];
        self.at += n;
        Ok(slice)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N)?);
        Ok(array)
    }

    /// A raw unsigned byte.
    pub fn u8(&mut self) -> Result<u8, DecodeError> {
        Ok(self.array::<1>()?[0])
    }

    /// A raw 32-bit integer.
    pub fn i32(&mut self) -> Result<i32, DecodeError> {
        self.array().map(i32::from_be_bytes)
    }

    /// A raw double.
    pub fn f64(&mut self) -> Result<f64, DecodeError> {
        self.array().map(f64::from_be_bytes)
    }

    /// A raw 32-bit count of things that take at least `size` bytes each, all of which must be there.
    pub fn count(&mut self, size: usize) -> Result<usize, DecodeError> {
        let at = self.at;
        let count = self.i32()?;
        let count = usize::try_from(count).map_err(|_| DecodeError::NegativeCount { count, at })?;
        let needed = count.saturating_mul(size);
        if needed > self.remaining() {
            return Err(DecodeError::Truncated { needed, left: self.remaining(), at: self.at });
        }
        Ok(count)
    }

    /// A raw string as bytes.
    pub fn str_bytes(&mut self) -> Result<&'a [u8], DecodeError> {
        let n = self.count(1)?;
        self.bytes(n)
    }

    /// A raw string.
    pub fn str(&mut self) -> Result<&'a str, DecodeError> {
        let at = self.at;
        std::str::from_utf8(self.str_bytes()?).map_err(|_| DecodeError::Utf8 { at })
    }

    /// Reads the tag byte and checks it.
    pub fn expect(&mut self, expected_tag: u8) -> Result<(), DecodeError> {
        let at = self.at;
        let found_tag = self.u8()?;
        if found_tag == expected_tag {
            return Ok(());
        }
        let (expected, found) = (type_name(expected_tag), type_name(found_tag));
        Err(DecodeError::Type { expected, expected_tag, found, found_tag, at })
    }

    /// A typed double.
    pub fn double(&mut self) -> Result<f64, DecodeError> {
        self.expect(tag::DOUBLE)?;
        self.f64()
    }

    /// A typed integer.
    pub fn integer(&mut self) -> Result<i32, DecodeError> {
        self.expect(tag::INTEGER)?;
        self.i32()
    }

    /// A typed signed byte.
    pub fn byte(&mut self) -> Result<i8, DecodeError> {
        self.expect(tag::BYTE)?;
        self.u8().map(|b| b as i8)
    }

    /// A typed unsigned byte.
    pub fn ubyte(&mut self) -> Result<u8, DecodeError> {
        self.expect(tag::UBYTE)?;
        self.u8()
    }

    /// A typed string, borrowed.
    pub fn string(&mut self) -> Result<&'a str, DecodeError> {
        self.expect(tag::STRING)?;
        self.str()
    }

    /// A typed string list, borrowed.
    pub fn strings(&mut self) -> Result<StringList<'a>, DecodeError> {
        self.expect(tag::STRING_LIST)?;
        let count = self.count(4)?;
        let start = *self;
        for _ in 0..count {
            self.str()?;
        }
        Ok(StringList { reader: start, left: count })
    }

    /// The head of a typed compound: its number of items.
    pub fn compound(&mut self) -> Result<usize, DecodeError> {
        self.expect(tag::COMPOUND)?;
        self.count(1)
    }

    /// The head of a typed compound that must have `expected` items.
    pub fn compound_of(&mut self, expected: usize) -> Result<(), DecodeError> {
        let at = self.at;
        match self.compound()? {
            found if found == expected => Ok(()),
            found => Err(DecodeError::Items { expected, found, at }),
        }
    }

    /// A typed integer that counts what follows.
    pub fn typed_count(&mut self) -> Result<usize, DecodeError> {
        self.expect(tag::INTEGER)?;
        self.count(1)
    }

    /// Points of a raw polygon.
    fn polygon_points(&mut self) -> Result<usize, DecodeError> {
        // One byte; where that is 0 a 32-bit number follows.
        match self.u8()? {
            0 => self.count(16),
            n if usize::from(n) * 16 > self.remaining() => Err(DecodeError::Truncated {
                needed: usize::from(n) * 16,
                left: self.remaining(),
                at: self.at,
            }),
            n => Ok(usize::from(n)),
        }
    }

    /// Walks over one typed value, whatever its type, and checks that it is all there.
    pub fn skip(&mut self) -> Result<(), DecodeError> {
        self.skip_nested(MAX_DEPTH)
    }

    fn skip_nested(&mut self, depth: u8) -> Result<(), DecodeError> {
        let at = self.at;
        let n = match self.u8()? {
            tag::DOUBLE => 8,
            tag::INTEGER | tag::COLOR => 4,
            tag::UBYTE | tag::BYTE => 1,
            tag::POSITION_2D | tag::POSITION_LON_LAT => 16,
            tag::POSITION_3D | tag::POSITION_LON_LAT_ALT => 24,
            tag::STRING => self.count(1)?,
            tag::DOUBLE_LIST => self.count(8)? * 8,
            tag::POLYGON => self.polygon_points()? * 16,
            tag::POSITION_ROADMAP => self.count(1)? + 9,
            tag::STRING_LIST => {
                for _ in 0..self.count(4)? {
                    self.str_bytes()?;
                }
                0
            }
            tag::COMPOUND => {
                let depth = depth.checked_sub(1).ok_or(DecodeError::TooDeep { at })?;
                for _ in 0..self.count(1)? {
                    self.skip_nested(depth)?;
                }
                0
            }
            tag => return Err(DecodeError::UnknownType { tag, at }),
        };
        self.bytes(n).map(|_| ())
    }

    /// Fails where bytes are left.
    pub fn finish(&self) -> Result<(), DecodeError> {
        match self.remaining() {
            0 => Ok(()),
            left => Err(DecodeError::Trailing { left, at: self.at }),
        }
    }
}

/// A list of strings inside a reply: iterates without allocating.
#[derive(Clone, Copy, Debug)]
pub struct StringList<'a> {
    reader: Reader<'a>,
    left: usize,
}

impl<'a> Iterator for StringList<'a> {
    type Item = &'a str;

    fn next(&mut self) -> Option<&'a str> {
        self.left = self.left.checked_sub(1)?;
        self.reader.str().ok()
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.left, Some(self.left))
    }
}

impl ExactSizeIterator for StringList<'_> {}

/// A type that a typed TraCI value can be read as.
pub trait Decode: Sized {
    /// Reads one typed value, tag first.
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError>;

    /// Reads all of `bytes` as one typed value.
    fn decode_all(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(bytes);
        let value = Self::decode(&mut reader)?;
        reader.finish()?;
        Ok(value)
    }
}

/// A type that can be written as a typed TraCI value.
///
/// `Arg` is what a caller hands over: the value itself, or a borrowed form.
pub trait Encode {
    /// The borrowed form (`&str` for `String`, a slice for a `Vec`).
    type Arg<'a>;
    /// Appends tag and value to `out`.
    fn encode(value: Self::Arg<'_>, out: &mut Vec<u8>);
}

/// Appends a raw string.
pub fn put_str(out: &mut Vec<u8>, text: &str) {
    put_count(out, text.len());
    out.extend_from_slice(text.as_bytes());
}

fn put_count(out: &mut Vec<u8>, count: usize) {
    // TraCI's counts end at 2 Gi; no caller comes near.
    out.extend_from_slice(&i32::try_from(count).unwrap_or(i32::MAX).to_be_bytes());
}

/// Appends the head of a compound of `items`.
pub fn put_compound(out: &mut Vec<u8>, items: usize) {
    out.push(tag::COMPOUND);
    put_count(out, items);
}
