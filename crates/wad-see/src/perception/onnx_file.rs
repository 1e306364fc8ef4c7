//! Reads the input's name and shape from an ONNX file, before OpenCV reads it.
//!
//! ONNX is a protocol buffer (onnx.proto): `ModelProto.graph` = 7; `GraphProto.initializer` = 5, `input`
//! = 11; `ValueInfoProto.name` = 1, `type` = 2; `TypeProto.tensor_type` = 1; its `shape` = 2; `dim` = 1;
//! `dim_value` = 1.

/// The network's input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// Its name.
    pub name: String,
    /// None where the file leaves a side open.
    pub shape: Vec<Option<usize>>,
}

/// The first input that is not one of the weights.
///
/// # Errors
/// The text says what is wrong with the bytes.
pub fn input(bytes: &[u8]) -> Result<Input, String> {
    let broken = || "it is not an ONNX file, or it is cut off".to_string();
    let graph = field(bytes, 7).map_err(|()| broken())?.into_iter().next().ok_or_else(broken)?;
    let weights = field(graph, 5).map_err(|()| broken())?;
    let weight_names: Vec<&[u8]> =
        weights.iter().filter_map(|w| field(w, 8).ok()?.into_iter().next()).collect();
    for value in field(graph, 11).map_err(|()| broken())? {
        let name = field(value, 1).map_err(|()| broken())?.into_iter().next().ok_or_else(broken)?;
        if weight_names.contains(&name) {
            continue;
        }
        let dims = (|| -> Result<Vec<Option<usize>>, ()> {
            let kind = one(value, 2)?;
            let tensor = one(kind, 1)?;
            let shape = one(tensor, 2)?;
            field(shape, 1)?.into_iter().map(size).collect()
        })()
        .map_err(|()| "its input is not a tensor with a shape".to_string())?;
        return Ok(Input { name: String::from_utf8_lossy(name).into_owned(), shape: dims });
    }
    Err("it has no input".to_string())
}

fn one(message: &[u8], number: u64) -> Result<&[u8], ()> {
    field(message, number)?.into_iter().next().ok_or(())
}

/// `dim_value`, a whole number; None where the dimension has a name instead.
fn size(dim: &[u8]) -> Result<Option<usize>, ()> {
    let mut rest = dim;
    while !rest.is_empty() {
        let key = varint(&mut rest)?;
        if key == 1 << 3 {
            return Ok(usize::try_from(varint(&mut rest)?).ok().filter(|&n| n > 0));
        }
        skip(&mut rest, key & 7)?;
    }
    Ok(None)
}

/// The contents of all length-delimited fields with this number.
fn field(mut message: &[u8], number: u64) -> Result<Vec<&[u8]>, ()> {
    let mut found = Vec::new();
    while !message.is_empty() {
        let key = varint(&mut message)?;
        if key == number << 3 | 2 {
            let length = usize::try_from(varint(&mut message)?).map_err(|_| ())?;
            let (content, rest) = message.split_at_checked(length).ok_or(())?;
            found.push(content);
            message = rest;
        } else {
            skip(&mut message, key & 7)?;
        }
    }
    Ok(found)
}

fn skip(message: &mut &[u8], wire_type: u64) -> Result<(), ()> {
    let length = match wire_type {
        0 => return varint(message).map(|_| ()),
        1 => 8,
        2 => usize::try_from(varint(message)?).map_err(|_| ())?,
        5 => 4,
        _ => return Err(()),
    };
    *message = message.get(length..).ok_or(())?;
    Ok(())
}

fn varint(message: &mut &[u8]) -> Result<u64, ()> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = message.split_first().ok_or(())?;
        *message = rest;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(number: u8, content: &[u8]) -> Vec<u8> {
        [&[number << 3 | 2, content.len() as u8][..], content].concat()
    }

    fn value(name: &str, dims: &[u8]) -> Vec<u8> {
        let dims: Vec<u8> = dims.iter().flat_map(|&d| message(1, &[1 << 3, d])).collect();
        let kind = message(1, &[&[1 << 3, 1][..], &message(2, &dims)].concat());
        [message(1, name.as_bytes()), message(2, &kind)].concat()
    }

    #[test]
    fn the_input_is_the_one_that_is_no_weight() {
        let graph = [
            message(5, &message(8, b"w")),
            message(11, &value("w", &[4, 4])),
            message(11, &value("images", &[1, 3, 64, 0])),
        ]
        .concat();
        let model = [vec![1 << 3, 6], message(7, &graph)].concat();
        let found = input(&model).unwrap();
        assert_eq!(found, Input { name: "images".into(), shape: vec![Some(1), Some(3), Some(64), None] });
        for cut in 3..model.len() {
            assert!(input(&model[..cut]).is_err(), "cut at {cut}");
        }
    }

    #[test]
    fn other_files_are_told_apart() {
        for bytes in [&b""[..], b"GIF89a......", b"\x89PNG\r\n\x1a\n", b"{\"a\": 1}"] {
            assert!(input(bytes).unwrap_err().contains("not an ONNX file"));
        }
    }
}
