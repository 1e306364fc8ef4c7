//! Bytes written by hand from the protocol's documentation.

use crate::codec::{Decode, DecodeError, Encode};
use crate::domains::{KeyValue, vehicle::Leader};
use crate::*;

/// Hex digits, blanks between them as one likes.
fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<char> = text.chars().filter(|c| !c.is_whitespace()).collect();
    digits.chunks(2).map(|pair| u8::from_str_radix(&String::from_iter(pair), 16).unwrap()).collect()
}

fn value_golden(bytes: &str, value: Value) {
    let bytes = hex(bytes);
    let mut out = Vec::new();
    Value::encode(&value, &mut out);
    assert_eq!(out, bytes, "{value:?}");
    assert_eq!(Value::decode_all(&bytes), Ok(value));
}

#[test]
fn every_data_type() {
    let (p1, p2) = (Position2D { x: 1.0, y: -2.0 }, Position2D { x: 0.5, y: 1.5 });
    value_golden("07 ff", Value::UByte(255));
    value_golden("08 fe", Value::Byte(-2));
    value_golden("09 ffffff85", Value::Integer(-123));
    value_golden("0b 3ff8000000000000", Value::Double(1.5));
    value_golden("0c 00000003 616263", Value::String("abc".into()));
    value_golden("0c 00000000", Value::String(String::new()));
    value_golden("0c 00000002 c3a4", Value::String("ä".into()));
    value_golden("0e 00000002 00000001 61 00000002 6263", Value::StringList(vec!["a".into(), "bc".into()]));
    value_golden("10 00000002 3ff0000000000000 c000000000000000", Value::DoubleList(vec![1.0, -2.0]));
    value_golden("11 01 02 03 ff", Value::Color(Color::rgb(1, 2, 3)));
    value_golden("01 3ff0000000000000 c000000000000000", Value::Position2D(p1));
    value_golden(
        "03 3ff0000000000000 c000000000000000 4008000000000000",
        Value::Position3D(Position3D { x: 1.0, y: -2.0, z: 3.0 }),
    );
    let geo = GeoPosition { longitude: 1.0, latitude: -2.0, altitude: None };
    value_golden("00 3ff0000000000000 c000000000000000", Value::Geo(geo));
    value_golden(
        "02 3ff0000000000000 c000000000000000 4008000000000000",
        Value::Geo(GeoPosition { altitude: Some(3.0), ..geo }),
    );
    value_golden(
        "04 00000002 4531 3ff8000000000000 02",
        Value::Road(RoadPosition { edge: "E1".into(), position: 1.5, lane_index: 2 }),
    );
    value_golden(
        "06 02 3ff0000000000000 c000000000000000 3fe0000000000000 3ff8000000000000",
        Value::Polygon(vec![p1, p2]),
    );
    value_golden("06 00 00000000", Value::Polygon(vec![]));
    value_golden(
        "0f 00000002 09 00000007 0f 00000001 07 01",
        Value::Compound(vec![Value::Integer(7), Value::Compound(vec![Value::UByte(1)])]),
    );
}

#[test]
fn a_polygon_of_more_than_255_points_has_a_long_count() {
    let points = vec![Position2D { x: 1.0, y: 2.0 }; 256];
    let mut out = Vec::new();
    Vec::<Position2D>::encode(&points, &mut out);
    assert_eq!(out[..6], hex("06 00 00000100"));
    assert_eq!(out.len(), 6 + 256 * 16);
    assert_eq!(Vec::<Position2D>::decode_all(&out).unwrap(), points);
}

#[test]
fn structures() {
    let leader = hex("0f 00000002 0c 00000001 76 0b 4024000000000000");
    assert_eq!(Option::<Leader>::decode_all(&leader), Ok(Some(Leader { id: "v".into(), gap: 10.0 })));
    let nobody = hex("0f 00000002 0c 00000000 0b bff0000000000000");
    assert_eq!(Option::<Leader>::decode_all(&nobody), Ok(None));
    // Neighbours are untyped inside their compound.
    let neighbors = hex("0f 00000001 00000001 76 4024000000000000");
    assert_eq!(Vec::<Leader>::decode_all(&neighbors), Ok(vec![Leader { id: "v".into(), gap: 10.0 }]));
    let pair = hex("0f 00000002 0c 00000001 6b 0c 00000001 76");
    assert_eq!(KeyValue::decode_all(&pair), Ok(KeyValue { key: "k".into(), value: "v".into() }));
}

#[test]
fn messages() {
    let mut batch = Batch::new();
    batch.get(vehicle::SPEED, "v0");
    assert_eq!(batch.message().unwrap(), hex("0000000d 09 a4 40 00000002 7630"));

    batch.clear();
    batch.set(vehicle::SET_SPEED, "v", 1.5);
    batch.step();
    let set = "11 c4 40 00000001 76 0b 3ff8000000000000";
    let step = "0a 02 0000000000000000";
    assert_eq!(batch.message().unwrap(), hex(&format!("0000001f {set} {step}")));

    batch.clear();
    batch.get_with(vehicle::leader(1.5), "v");
    assert_eq!(batch.message().unwrap(), hex("00000015 11 a4 68 00000001 76 0b 3ff8000000000000"));

    batch.clear();
    batch.subscribe(vehicle::Vehicle, "v", &[vehicle::SPEED.id(), vehicle::leader(1.5).id()]);
    let always = "c1d0000000000000 c1d0000000000000";
    assert_eq!(
        batch.message().unwrap(),
        hex(&format!("00000027 23 d4 {always} 00000001 76 02 40 68 0b 3ff8000000000000"))
    );

    batch.clear();
    batch.subscribe_context(vehicle::Vehicle, "v", person::Person, 1.5, &[person::SPEED.id()]);
    assert_eq!(
        batch.message().unwrap(),
        hex(&format!("00000026 22 84 {always} 00000001 76 ae 3ff8000000000000 01 40"))
    );

    batch.clear();
    vehicle::remove(&mut batch, "v", RemoveReason::Arrived);
    assert_eq!(batch.message().unwrap(), hex("0000000e 0a c4 81 00000001 76 08 02"));

    batch.clear();
    let to = vehicle::MoveToXy { x: 1.0, y: -2.0, angle_deg: 90.0, keep_route: 3, ..Default::default() };
    vehicle::move_to_xy(&mut batch, "e", &to);
    let items = "0c 00000000 09 ffffffff 0b 3ff0000000000000 0b c000000000000000 0b 4056800000000000 \
                 08 03 0b 4059000000000000";
    assert_eq!(batch.message().unwrap(), hex(&format!("00000041 3d c4 b4 00000001 65 0f 00000007 {items}")));
}

#[test]
fn a_long_command_has_a_long_length() {
    let mut batch = Batch::new();
    // 249 bytes of id are the most for one length byte: 1 + 1 + 1 + 4 + 248 = 255.
    batch.get(vehicle::SPEED, &"x".repeat(248));
    assert_eq!(batch.message().unwrap()[..7], hex("00000103 ff a4 40"));
    batch.clear();
    batch.get(vehicle::SPEED, &"x".repeat(249));
    assert_eq!(batch.message().unwrap()[..11], hex("00000108 00 00000104 a4 40"));
    assert_eq!(batch.object(&batch.commands()[0]), "x".repeat(249));
}

#[test]
fn a_step_is_the_last_command_and_the_only_one() {
    let mut batch = Batch::new();
    batch.step();
    batch.step();
    assert!(batch.message().unwrap_err().contains("two simulation steps"));
    batch.clear();
    batch.step();
    batch.get(vehicle::SPEED, "v");
    assert!(batch.message().unwrap_err().contains("must be the last"));
    batch.clear();
    batch.subscribe(vehicle::Vehicle, "v", &[]);
    assert!(batch.message().unwrap_err().contains("without variables"));
    batch.clear();
    batch.step();
    assert!(batch.message().is_ok());
}

#[test]
fn a_cleared_batch_keeps_its_memory() {
    let mut batch = Batch::new();
    let fill = |batch: &mut Batch| {
        batch.clear();
        for _ in 0..100 {
            batch.get(vehicle::SPEED, "vehicle");
        }
        batch.message().unwrap().as_ptr()
    };
    let first = fill(&mut batch);
    assert_eq!(fill(&mut batch), first);
}

#[test]
fn errors_say_what_was_expected_and_what_was_found() {
    let wrong = f64::decode_all(&hex("09 00000001")).unwrap_err();
    assert_eq!(wrong.to_string(), "expected double (type 0x0b), found integer (type 0x09) at byte 0");
    let short = f64::decode_all(&hex("0b 0000")).unwrap_err();
    assert_eq!(short, DecodeError::Truncated { needed: 8, left: 2, at: 1 });
    assert_eq!(Value::decode_all(&[0x42]), Err(DecodeError::UnknownType { tag: 0x42, at: 0 }));
    assert_eq!(u8::decode_all(&hex("07 01 02")), Err(DecodeError::Trailing { left: 1, at: 2 }));
    assert_eq!(String::decode_all(&hex("0c 00000001 ff")), Err(DecodeError::Utf8 { at: 1 }));
    let negative = String::decode_all(&hex("0c ffffffff")).unwrap_err();
    assert_eq!(negative, DecodeError::NegativeCount { count: -1, at: 1 });
}

#[test]
fn nesting_without_end_is_refused() {
    let deep: Vec<u8> = hex("0f 00000001").repeat(100_000);
    assert!(matches!(Value::decode_all(&deep), Err(DecodeError::TooDeep { .. })));
}
