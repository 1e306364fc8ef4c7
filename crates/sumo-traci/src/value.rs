//! Values whose type is only known when they arrive.

use super::codec::{Decode, DecodeError, Encode, MAX_DEPTH, Reader, put_compound, tag};
use super::types::{Color, GeoPosition, Position2D, Position3D, RoadPosition};

/// Any typed value, for data whose type is only known when it arrives.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// 8 bits without sign.
    UByte(u8),
    /// 8 bits with sign.
    Byte(i8),
    /// 32 bits with sign.
    Integer(i32),
    /// A floating-point number.
    Double(f64),
    /// Text.
    String(String),
    /// Texts.
    StringList(Vec<String>),
    /// Floating-point numbers.
    DoubleList(Vec<f64>),
    /// A colour.
    Color(Color),
    /// A position in the plane (m).
    Position2D(Position2D),
    /// A position with height (m).
    Position3D(Position3D),
    /// Longitude and latitude.
    Geo(GeoPosition),
    /// A position on the road network.
    Road(RoadPosition),
    /// A line or area (m).
    Polygon(Vec<Position2D>),
    /// Several values.
    Compound(Vec<Value>),
}

impl Value {
    fn decode_nested(reader: &mut Reader<'_>, depth: u8) -> Result<Self, DecodeError> {
        let at = reader.position();
        let mut ahead = *reader;
        Ok(match ahead.u8()? {
            tag::UBYTE => Self::UByte(u8::decode(reader)?),
            tag::BYTE => Self::Byte(i8::decode(reader)?),
            tag::INTEGER => Self::Integer(i32::decode(reader)?),
            tag::DOUBLE => Self::Double(f64::decode(reader)?),
            tag::STRING => Self::String(String::decode(reader)?),
            tag::STRING_LIST => Self::StringList(Vec::decode(reader)?),
            tag::DOUBLE_LIST => Self::DoubleList(Vec::decode(reader)?),
            tag::COLOR => Self::Color(Color::decode(reader)?),
            tag::POSITION_2D => Self::Position2D(Position2D::decode(reader)?),
            tag::POSITION_3D => Self::Position3D(Position3D::decode(reader)?),
            tag::POSITION_LON_LAT | tag::POSITION_LON_LAT_ALT => Self::Geo(GeoPosition::decode(reader)?),
            tag::POSITION_ROADMAP => Self::Road(RoadPosition::decode(reader)?),
            tag::POLYGON => Self::Polygon(Vec::decode(reader)?),
            tag::COMPOUND => {
                let depth = depth.checked_sub(1).ok_or(DecodeError::TooDeep { at })?;
                let items = reader.compound()?;
                let mut values = Vec::new();
                for _ in 0..items {
                    values.push(Self::decode_nested(reader, depth)?);
                }
                Self::Compound(values)
            }
            tag => return Err(DecodeError::UnknownType { tag, at }),
        })
    }
}

impl Decode for Value {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Self::decode_nested(reader, MAX_DEPTH)
    }
}

impl Encode for Value {
    type Arg<'a> = &'a Value;
    fn encode(value: &Value, out: &mut Vec<u8>) {
        match value {
            Value::UByte(v) => u8::encode(*v, out),
            Value::Byte(v) => i8::encode(*v, out),
            Value::Integer(v) => i32::encode(*v, out),
            Value::Double(v) => f64::encode(*v, out),
            Value::String(v) => String::encode(v, out),
            Value::StringList(v) => {
                Vec::<String>::encode(&v.iter().map(String::as_str).collect::<Vec<_>>(), out)
            }
            Value::DoubleList(v) => Vec::<f64>::encode(v, out),
            Value::Color(v) => Color::encode(*v, out),
            Value::Position2D(v) => Position2D::encode(*v, out),
            Value::Position3D(v) => Position3D::encode(*v, out),
            Value::Geo(v) => GeoPosition::encode(*v, out),
            Value::Road(v) => RoadPosition::encode(v, out),
            Value::Polygon(v) => Vec::<Position2D>::encode(v, out),
            Value::Compound(items) => {
                put_compound(out, items.len());
                items.iter().for_each(|item| Value::encode(item, out));
            }
        }
    }
}
