//! Each of TraCI's types as typed values: tag first.

use super::{Decode, DecodeError, Encode, Reader, put_count, put_str, tag};
use crate::types::{Color, GeoPosition, Position2D, Position3D, RoadPosition};

/// Nothing: the "value" of commands that only have a status.
impl Decode for () {
    fn decode(_: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(())
    }
}

impl Decode for f64 {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.double()
    }
}

impl Encode for f64 {
    type Arg<'a> = f64;
    fn encode(value: f64, out: &mut Vec<u8>) {
        out.push(tag::DOUBLE);
        out.extend_from_slice(&value.to_be_bytes());
    }
}

impl Decode for i32 {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.integer()
    }
}

impl Encode for i32 {
    type Arg<'a> = i32;
    fn encode(value: i32, out: &mut Vec<u8>) {
        out.push(tag::INTEGER);
        out.extend_from_slice(&value.to_be_bytes());
    }
}

/// SUMO writes truth values as integers.
impl Decode for bool {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.integer().map(|v| v != 0)
    }
}

impl Encode for bool {
    type Arg<'a> = bool;
    fn encode(value: bool, out: &mut Vec<u8>) {
        i32::encode(value.into(), out);
    }
}

impl Decode for u8 {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.ubyte()
    }
}

impl Encode for u8 {
    type Arg<'a> = u8;
    fn encode(value: u8, out: &mut Vec<u8>) {
        out.extend_from_slice(&[tag::UBYTE, value]);
    }
}

impl Decode for i8 {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.byte()
    }
}

impl Encode for i8 {
    type Arg<'a> = i8;
    fn encode(value: i8, out: &mut Vec<u8>) {
        out.extend_from_slice(&[tag::BYTE, value as u8]);
    }
}

impl Decode for String {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.string().map(str::to_owned)
    }
}

impl Encode for String {
    type Arg<'a> = &'a str;
    fn encode(value: &str, out: &mut Vec<u8>) {
        out.push(tag::STRING);
        put_str(out, value);
    }
}

impl Decode for Vec<String> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(reader.strings()?.map(str::to_owned).collect())
    }
}

impl Encode for Vec<String> {
    type Arg<'a> = &'a [&'a str];
    fn encode(value: &[&str], out: &mut Vec<u8>) {
        out.push(tag::STRING_LIST);
        put_count(out, value.len());
        value.iter().for_each(|text| put_str(out, text));
    }
}

impl Decode for Vec<f64> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.expect(tag::DOUBLE_LIST)?;
        let count = reader.count(8)?;
        (0..count).map(|_| reader.f64()).collect()
    }
}

impl Encode for Vec<f64> {
    type Arg<'a> = &'a [f64];
    fn encode(value: &[f64], out: &mut Vec<u8>) {
        out.push(tag::DOUBLE_LIST);
        put_count(out, value.len());
        value.iter().for_each(|v| out.extend_from_slice(&v.to_be_bytes()));
    }
}

impl Decode for Color {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.expect(tag::COLOR)?;
        let [r, g, b, a] = reader.array()?;
        Ok(Self { r, g, b, a })
    }
}

impl Encode for Color {
    type Arg<'a> = Color;
    fn encode(value: Color, out: &mut Vec<u8>) {
        out.extend_from_slice(&[tag::COLOR, value.r, value.g, value.b, value.a]);
    }
}

impl Decode for Position2D {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.expect(tag::POSITION_2D)?;
        Ok(Self { x: reader.f64()?, y: reader.f64()? })
    }
}

impl Encode for Position2D {
    type Arg<'a> = Position2D;
    fn encode(value: Position2D, out: &mut Vec<u8>) {
        out.push(tag::POSITION_2D);
        out.extend_from_slice(&value.x.to_be_bytes());
        out.extend_from_slice(&value.y.to_be_bytes());
    }
}

impl Decode for Position3D {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.expect(tag::POSITION_3D)?;
        Ok(Self { x: reader.f64()?, y: reader.f64()?, z: reader.f64()? })
    }
}

impl Encode for Position3D {
    type Arg<'a> = Position3D;
    fn encode(value: Position3D, out: &mut Vec<u8>) {
        out.push(tag::POSITION_3D);
        for v in [value.x, value.y, value.z] {
            out.extend_from_slice(&v.to_be_bytes());
        }
    }
}

impl Decode for GeoPosition {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let mut ahead = *reader;
        if ahead.u8()? == tag::POSITION_LON_LAT_ALT {
            *reader = ahead;
            let (longitude, latitude) = (reader.f64()?, reader.f64()?);
            return Ok(Self { longitude, latitude, altitude: Some(reader.f64()?) });
        }
        reader.expect(tag::POSITION_LON_LAT)?;
        Ok(Self { longitude: reader.f64()?, latitude: reader.f64()?, altitude: None })
    }
}

impl Encode for GeoPosition {
    type Arg<'a> = GeoPosition;
    fn encode(value: GeoPosition, out: &mut Vec<u8>) {
        out.push(if value.altitude.is_some() { tag::POSITION_LON_LAT_ALT } else { tag::POSITION_LON_LAT });
        for v in [Some(value.longitude), Some(value.latitude), value.altitude].into_iter().flatten() {
            out.extend_from_slice(&v.to_be_bytes());
        }
    }
}

impl Decode for RoadPosition {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.expect(tag::POSITION_ROADMAP)?;
        Ok(Self { edge: reader.str()?.to_owned(), position: reader.f64()?, lane_index: reader.u8()? })
    }
}

impl Encode for RoadPosition {
    type Arg<'a> = &'a RoadPosition;
    fn encode(value: &RoadPosition, out: &mut Vec<u8>) {
        out.push(tag::POSITION_ROADMAP);
        put_str(out, &value.edge);
        out.extend_from_slice(&value.position.to_be_bytes());
        out.push(value.lane_index);
    }
}

impl Decode for Vec<Position2D> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.expect(tag::POLYGON)?;
        let points = reader.polygon_points()?;
        (0..points).map(|_| Ok(Position2D { x: reader.f64()?, y: reader.f64()? })).collect()
    }
}

impl Encode for Vec<Position2D> {
    type Arg<'a> = &'a [Position2D];
    fn encode(value: &[Position2D], out: &mut Vec<u8>) {
        out.push(tag::POLYGON);
        match u8::try_from(value.len()) {
            Ok(n) if n > 0 => out.push(n),
            _ => {
                out.push(0);
                put_count(out, value.len());
            }
        }
        for p in value {
            out.extend_from_slice(&p.x.to_be_bytes());
            out.extend_from_slice(&p.y.to_be_bytes());
        }
    }
}
