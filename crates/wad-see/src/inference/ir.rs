//! A network as OpenVINO's intermediate representation, version 11: operations in XML, numbers in one array.
//!
//! <https://docs.openvino.ai/2026/documentation/openvino-ir-format/operation-sets.html>

use std::fmt::Write as _;

/// An operation's output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Node {
    layer: usize,
    port: usize,
}

/// A network in the making: each call adds an operation of that name.
#[derive(Clone, Debug, Default)]
pub struct Ir {
    layers: String,
    edges: String,
    constants: Vec<u8>,
    count: usize,
    outputs: usize,
}

/// `1,2,3`.
fn list(numbers: &[usize]) -> String {
    numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(",")
}

impl Ir {
    /// The network in XML.
    pub fn xml(&self) -> String {
        let Self { layers, edges, .. } = self;
        format!(
            "<?xml version=\"1.0\"?>\n<net name=\"network\" version=\"11\"><layers>\n{layers}</layers><edges>\n{edges}</edges></net>\n"
        )
    }

    /// What [`Ir::xml`]'s constants mean by their offsets.
    pub fn constants(&self) -> &[u8] {
        &self.constants
    }

    /// Outputs so far.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// An operation of the set `opset`, with attributes in XML; its output is in single precision.
    fn add(&mut self, kind: &str, opset: u32, data: &str, inputs: &[Node]) -> Node {
        self.layer(kind, opset, data, inputs, Some("FP32"))
    }

    fn layer(&mut self, kind: &str, opset: u32, data: &str, inputs: &[Node], output: Option<&str>) -> Node {
        let (id, port) = (self.count, inputs.len());
        self.count += 1;
        // Writing to a string cannot fail.
        let _ = write!(
            self.layers,
            "<layer id=\"{id}\" name=\"{kind}{id}\" type=\"{kind}\" version=\"opset{opset}\">"
        );
        if !data.is_empty() {
            let _ = write!(self.layers, "<data {data}/>");
        }
        if !inputs.is_empty() {
            self.layers.push_str("<input>");
            for (to, from) in inputs.iter().enumerate() {
                let _ = write!(self.layers, "<port id=\"{to}\"/>");
                let _ = writeln!(
                    self.edges,
                    "<edge from-layer=\"{}\" from-port=\"{}\" to-layer=\"{id}\" to-port=\"{to}\"/>",
                    from.layer, from.port
                );
            }
            self.layers.push_str("</input>");
        }
        if let Some(precision) = output {
            let _ = write!(self.layers, "<output><port id=\"{port}\" precision=\"{precision}\"/></output>");
        }
        self.layers.push_str("</layer>\n");
        Node { layer: id, port }
    }

    /// The network's input: bytes.
    pub fn bytes(&mut self, shape: &[usize]) -> Node {
        let data = format!("shape=\"{}\" element_type=\"u8\"", list(shape));
        self.layer("Parameter", 1, &data, &[], Some("U8"))
    }

    fn constant(&mut self, kind: &str, shape: &[usize], bytes: impl Iterator<Item = u8>) -> Node {
        let offset = self.constants.len();
        self.constants.extend(bytes);
        let size = self.constants.len() - offset;
        let shape = list(shape);
        let data = format!("element_type=\"{kind}\" shape=\"{shape}\" offset=\"{offset}\" size=\"{size}\"");
        self.layer("Const", 1, &data, &[], Some(if kind == "i64" { "I64" } else { "FP32" }))
    }

    /// Numbers of single precision.
    pub fn floats(&mut self, shape: &[usize], numbers: &[f32]) -> Node {
        self.constant("f32", shape, numbers.iter().flat_map(|x| x.to_le_bytes()))
    }

    /// Whole numbers.
    pub fn integers(&mut self, numbers: &[i64]) -> Node {
        self.constant("i64", &[numbers.len()], numbers.iter().flat_map(|x| x.to_le_bytes()))
    }

    /// Bytes as numbers of single precision.
    pub fn to_float(&mut self, x: Node) -> Node {
        self.add("Convert", 1, "destination_type=\"f32\"", &[x])
    }

    /// (n, rows, columns, channels) to (n, channels, rows, columns).
    pub fn channels_first(&mut self, x: Node) -> Node {
        let order = self.integers(&[0, 3, 1, 2]);
        self.add("Transpose", 1, "", &[x, order])
    }

    /// The product.
    pub fn multiply(&mut self, a: Node, b: Node) -> Node {
        self.add("Multiply", 1, "auto_broadcast=\"numpy\"", &[a, b])
    }

    /// The sum.
    pub fn sum(&mut self, a: Node, b: Node) -> Node {
        self.add("Add", 1, "auto_broadcast=\"numpy\"", &[a, b])
    }

    /// Numbers below 0 become 0.
    pub fn relu(&mut self, x: Node) -> Node {
        self.add("ReLU", 1, "", &[x])
    }

    /// Convolution of (n, from, h, w) by (to, from, side, side), side odd, with a border of zeros of half a side.
    pub fn convolution(
        &mut self,
        x: Node,
        weight: Node,
        side: usize,
        stride: usize,
        dilation: usize,
    ) -> Node {
        let pad = side / 2 * dilation;
        let data = format!(
            "strides=\"{stride},{stride}\" pads_begin=\"{pad},{pad}\" pads_end=\"{pad},{pad}\" dilations=\"{dilation},{dilation}\" \
             auto_pad=\"explicit\""
        );
        self.add("Convolution", 1, &data, &[x, weight])
    }

    /// Twice as high and wide, each number four times.
    pub fn double(&mut self, x: Node) -> Node {
        let sizes = self.integers(&[0, 0]);
        let scales = self.floats(&[2], &[2.0, 2.0]);
        let axes = self.integers(&[2, 3]);
        let data = "mode=\"nearest\" shape_calculation_mode=\"scales\" \
                    coordinate_transformation_mode=\"asymmetric\" nearest_mode=\"floor\" antialias=\"false\" \
                    pads_begin=\"0\" pads_end=\"0\" cube_coeff=\"-0.75\"";
        self.add("Interpolate", 4, data, &[x, sizes, scales, axes])
    }

    /// Half as high and wide, each number the mean of four.
    pub fn halve(&mut self, x: Node) -> Node {
        self.pool("AvgPool", "exclude-pad=\"true\"", x, 2)
    }

    /// The largest number of each square of `side`.
    pub fn largest(&mut self, x: Node, side: usize) -> Node {
        self.pool("MaxPool", "", x, side)
    }

    /// One number for each square of `side`.
    fn pool(&mut self, kind: &str, more: &str, x: Node, side: usize) -> Node {
        let data = format!(
            "kernel=\"{side},{side}\" strides=\"{side},{side}\" pads_begin=\"0,0\" pads_end=\"0,0\" {more} \
             rounding_type=\"floor\" auto_pad=\"explicit\""
        );
        self.add(kind, 1, &data, &[x])
    }

    /// What lies from `from` to before `to` along a dimension.
    pub fn part(&mut self, x: Node, axis: i64, from: i64, to: i64) -> Node {
        let [from, to, step, axis] = [from, to, 1, axis].map(|number| self.integers(&[number]));
        self.add("Slice", 8, "", &[x, from, to, step, axis])
    }

    /// The mean along a dimension, which is 1 long then.
    pub fn mean(&mut self, x: Node, axis: i64) -> Node {
        let axis = self.integers(&[axis]);
        self.add("ReduceMean", 1, "keep_dims=\"true\"", &[x, axis])
    }

    /// Both, one behind the other along a dimension.
    pub fn join(&mut self, a: Node, b: Node, axis: i64) -> Node {
        self.add("Concat", 1, &format!("axis=\"{axis}\""), &[a, b])
    }

    /// Rounds to one of `levels` numbers from `low` to `high`, which are the same for all or have a shape that fits.
    /// OpenVINO computes in whole numbers where both sides of a convolution are rounded so.
    pub fn round(&mut self, x: Node, low: Node, high: Node, levels: u32) -> Node {
        let data = format!("levels=\"{levels}\" auto_broadcast=\"numpy\"");
        self.add("FakeQuantize", 1, &data, &[x, low, high, low, high])
    }

    /// The network's next output.
    pub fn output(&mut self, x: Node) {
        self.outputs += 1;
        self.layer("Result", 1, "", &[x], None);
    }
}
