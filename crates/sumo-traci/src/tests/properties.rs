//! What must hold for all values and all garbage.

use crate::codec::{Decode, Encode, Reader};
use crate::domains::{KeyValue, Stage, person, traffic_light, vehicle};
use crate::replies::Replies;
use crate::simulation::Collision;
use crate::*;
use bytes::Bytes;
use proptest::prelude::*;

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![proptest::num::f64::NORMAL, Just(0.0), Just(-1_073_741_824.0)]
}

fn position() -> impl Strategy<Value = Position2D> {
    (number(), number()).prop_map(|(x, y)| Position2D { x, y })
}

fn any_value() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        any::<u8>().prop_map(Value::UByte),
        any::<i8>().prop_map(Value::Byte),
        any::<i32>().prop_map(Value::Integer),
        number().prop_map(Value::Double),
        any::<String>().prop_map(Value::String),
        proptest::collection::vec(any::<String>(), 0..5).prop_map(Value::StringList),
        proptest::collection::vec(number(), 0..5).prop_map(Value::DoubleList),
        any::<[u8; 4]>().prop_map(|[r, g, b, a]| Value::Color(Color { r, g, b, a })),
        position().prop_map(Value::Position2D),
        [number(), number(), number()].prop_map(|[x, y, z]| Value::Position3D(Position3D { x, y, z })),
        (number(), number(), proptest::option::of(number())).prop_map(|(longitude, latitude, altitude)| {
            Value::Geo(GeoPosition { longitude, latitude, altitude })
        }),
        (any::<String>(), number(), any::<u8>()).prop_map(|(edge, position, lane_index)| {
            Value::Road(RoadPosition { edge, position, lane_index })
        }),
        proptest::collection::vec(position(), 0..300).prop_map(Value::Polygon),
    ];
    leaf.prop_recursive(4, 40, 6, |inner| proptest::collection::vec(inner, 0..6).prop_map(Value::Compound))
}

fn encoded(value: &Value) -> Vec<u8> {
    let mut out = Vec::new();
    Value::encode(value, &mut out);
    out
}

/// Decodes bytes as everything there is; only panics matter.
fn decode_as_anything(bytes: &[u8]) {
    let _ = Value::decode_all(bytes);
    let _ = Reader::new(bytes).skip();
    let _ = f64::decode_all(bytes);
    let _ = bool::decode_all(bytes);
    let _ = Vec::<String>::decode_all(bytes);
    let _ = Vec::<f64>::decode_all(bytes);
    let _ = Vec::<Position2D>::decode_all(bytes);
    let _ = RoadPosition::decode_all(bytes);
    let _ = GeoPosition::decode_all(bytes);
    let _ = KeyValue::decode_all(bytes);
    let _ = Stage::decode_all(bytes);
    let _ = Vec::<Stage>::decode_all(bytes);
    let _ = Vec::<Collision>::decode_all(bytes);
    let _ = Option::<vehicle::Leader>::decode_all(bytes);
    let _ = Vec::<vehicle::Leader>::decode_all(bytes);
    let _ = Vec::<vehicle::BestLane>::decode_all(bytes);
    let _ = Vec::<vehicle::NextTrafficLight>::decode_all(bytes);
    let _ = Vec::<vehicle::NextLink>::decode_all(bytes);
    let _ = Vec::<vehicle::JunctionFoe>::decode_all(bytes);
    let _ = Vec::<vehicle::Stop>::decode_all(bytes);
    let _ = Vec::<person::TaxiReservation>::decode_all(bytes);
    let _ = Vec::<traffic_light::Program>::decode_all(bytes);
    let _ = Vec::<Vec<traffic_light::ControlledLink>>::decode_all(bytes);
}

/// An answer to [`example_batch`] as SUMO would give it.
fn example_answer(values: &[Value]) -> Vec<u8> {
    let frame = |body: &[u8]| {
        let mut out = vec![0];
        out.extend((body.len() as i32 + 5).to_be_bytes());
        out.extend(body);
        out
    };
    let status = |command: u8| vec![7, command, 0, 0, 0, 0, 0];
    let mut answer = status(0xa4);
    let mut get = vec![0xb4, 0x40, 0, 0, 0, 1, b'v'];
    f64::encode(3.0, &mut get);
    answer.extend(frame(&get));
    answer.extend(status(0x02));
    answer.extend([0, 0, 0, 2]);
    let mut variables = vec![0xe4, 0, 0, 0, 1, b'v', values.len() as u8];
    for (i, value) in values.iter().enumerate() {
        variables.extend([i as u8, 0]);
        variables.extend(encoded(value));
    }
    answer.extend(frame(&variables));
    let mut context = vec![0x94, 0, 0, 0, 1, b'e', 0xa4, 1, 0, 0, 0, 2];
    for id in [b'a', b'b'] {
        context.extend([0, 0, 0, 1, id, 0x40, 0]);
        f64::encode(f64::from(id), &mut context);
    }
    answer.extend(frame(&context));
    answer
}

fn example_batch() -> (Batch, Ticket<f64>) {
    let mut batch = Batch::new();
    let ticket = batch.get(vehicle::SPEED, "v");
    batch.step();
    (batch, ticket)
}

fn read_everything(replies: &Replies, ticket: Ticket<f64>) {
    let _ = replies.get(ticket);
    let _ = replies.check();
    for result in replies.subscriptions().iter() {
        for object in result.objects() {
            let _ = (object.id(), object.value(vehicle::SPEED), object.str(vehicle::ROAD_ID));
        }
    }
}

proptest! {
    #[test]
    fn what_is_written_is_read(value in any_value()) {
        let bytes = encoded(&value);
        prop_assert_eq!(Value::decode_all(&bytes), Ok(value));
        let mut reader = Reader::new(&bytes);
        prop_assert_eq!(reader.skip(), Ok(()));
        prop_assert_eq!(reader.remaining(), 0);
    }

    #[test]
    fn a_truncated_value_is_an_error(value in any_value(), cut in any::<prop::sample::Index>()) {
        let bytes = encoded(&value);
        let cut = &bytes[..cut.index(bytes.len())];
        prop_assert!(Value::decode_all(cut).is_err());
        decode_as_anything(cut);
    }

    #[test]
    fn corrupted_values_never_panic(value in any_value(), at in any::<prop::sample::Index>(), byte: u8) {
        let mut bytes = encoded(&value);
        let at = at.index(bytes.len());
        bytes[at] = byte;
        decode_as_anything(&bytes);
    }

    #[test]
    fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        decode_as_anything(&bytes);
        let (batch, ticket) = example_batch();
        if let Ok(replies) = Replies::parse(&batch, Bytes::from(bytes)) {
            read_everything(&replies, ticket);
        }
    }

    #[test]
    fn answers_are_read_whole_or_not_at_all(
        values in proptest::collection::vec(any_value(), 1..5),
        at in any::<prop::sample::Index>(),
        byte: u8,
    ) {
        let answer = example_answer(&values);
        let (batch, ticket) = example_batch();
        let replies = Replies::parse(&batch, Bytes::from(answer.clone())).unwrap();
        prop_assert_eq!(replies.get(ticket), Ok(3.0));
        let results = replies.subscriptions();
        let object = results.object(vehicle::Vehicle, "v").unwrap();
        for (code, value) in values.iter().enumerate().rev() {
            let variable: Variable<vehicle::Vehicle, Value> = Variable::new(code as u8, "any");
            prop_assert_eq!(&object.value(variable).unwrap(), value);
        }
        let near: Vec<(&str, f64)> = results
            .context(vehicle::Vehicle, "e", vehicle::Vehicle)
            .map(|o| (o.id(), o.value(vehicle::SPEED).unwrap()))
            .collect();
        prop_assert_eq!(near, [("a", 97.0), ("b", 98.0)]);

        let at = at.index(answer.len());
        prop_assert!(Replies::parse(&batch, Bytes::copy_from_slice(&answer[..at])).is_err());
        let mut corrupted = answer;
        corrupted[at] = byte;
        if let Ok(replies) = Replies::parse(&batch, Bytes::from(corrupted)) {
            read_everything(&replies, ticket);
        }
    }
}

#[test]
fn a_claimed_length_is_not_allocated() {
    // Counts of two thousand million, with nothing behind them.
    for tag in ["0c", "0e", "10", "0f", "0600"] {
        let mut bytes: Vec<u8> = tag
            .as_bytes()
            .chunks(2)
            .map(|d| u8::from_str_radix(std::str::from_utf8(d).unwrap(), 16).unwrap())
            .collect();
        bytes.extend(0x7fff_ffff_i32.to_be_bytes());
        assert!(Value::decode_all(&bytes).is_err(), "{tag}");
    }
    // As many items as there are bytes is the most that a count may claim, and then they are missing.
    let mut bytes = vec![0x0f];
    bytes.extend(1_000_000_i32.to_be_bytes());
    bytes.extend(vec![0x07; 1_000_000]);
    assert!(Value::decode_all(&bytes).is_err());
}
