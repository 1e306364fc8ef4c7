#!/usr/bin/env python3
"""Turn the TensorFlow.js CenterNet of npm's @vladmandic/human into an ONNX file. Needs Python alone.

    centernet_to_onnx.py FOLDER/centernet.json OUT.onnx

Input: 1x3x512x512, RGB, 0..255, not normalised. Outputs: `tower_0/Sigmoid`, 1x80x128x128, the heatmap in
COCO's order of 80 classes; `tower_0/mul`, 1x4x128x128, the distances from a peak to the box's left, top,
right and bottom in pixels of the input. Peaks are cells of 4x4 pixels.

Only what this network is made of is known here; anything else ends with an error. Relu6 is written as
6 * HardSigmoid(x / 6), which OpenCV 4.6 reads (it refuses opset 11's Clip).
"""
import base64
import json
import os
import struct
import sys
from itertools import product
from math import prod

OUTPUTS = ("tower_0/Sigmoid", "tower_0/mul")


# ---- protocol buffers, as far as ONNX needs them -------------------------------------------------

def varint(value):
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number, value):
    """One field: whole numbers, floats, text, bytes (messages too) or a list of them."""
    if isinstance(value, (list, tuple)):
        return b"".join(field(number, v) for v in value)
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    if isinstance(value, float):
        return varint(number << 3 | 5) + struct.pack("<f", value)
    if isinstance(value, str):
        value = value.encode()
    return varint(number << 3 | 2) + varint(len(value)) + value


def attribute(name, value):
    kinds = {float: (2, 1), int: (3, 2), str: (4, 3), list: (8, 7)}  # field, AttributeType
    number, kind = kinds[type(value)]
    return field(1, name) + field(number, value) + field(20, kind)


def node(op, inputs, output, **attributes):
    listed = [attribute(k, v) for k, v in attributes.items()]
    return field(1, inputs) + field(2, output) + field(3, output) + field(4, op) + field(5, listed)


def tensor(name, shape, values):
    return field(1, list(shape)) + field(2, 1) + field(8, name) + field(9, struct.pack(f"<{len(values)}f", *values))


def value_info(name, shape):
    dims = b"".join(field(1, field(1, d)) for d in shape)
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, dims)))


# ---- the network ---------------------------------------------------------------------------------

def read(path):
    """The graph's nodes by name, and the weights: name -> (shape, values)."""
    with open(path, encoding="utf-8") as file:
        model = json.load(file)
    manifest = model["weightsManifest"][0]
    data = b"".join(open(os.path.join(os.path.dirname(path), p), "rb").read() for p in manifest["paths"])
    formats = {"float16": ("e", 2), "float32": ("f", 4), "int32": ("i", 4)}
    weights, at = {}, 0
    for entry in manifest["weights"]:
        letter, size = formats[entry.get("quantization", {}).get("dtype", entry["dtype"])]
        count = prod(entry["shape"])
        values = struct.unpack_from(f"<{count}{letter}", data, at)
        at += count * size
        weights[entry["name"]] = (entry["shape"], values)
    if at != len(data):
        sys.exit(f"{path}: the weights name {at} bytes, the files hold {len(data)}")
    return {n["name"]: n for n in model["modelTopology"]["node"]}, weights


def transposed(shape, values, axes):
    """As numpy's transpose."""
    strides = [prod(shape[k + 1:]) for k in range(len(shape))]
    steps = [[strides[a] * i for i in range(shape[a])] for a in axes]
    return [shape[a] for a in axes], [values[sum(offsets)] for offsets in product(*steps)]


class Converter:
    def __init__(self, nodes, weights):
        self.graph, self.weights = nodes, weights
        self.nodes, self.inits, self.shapes, self.alias = [], {}, {}, {}
        self.input = None

    def name(self, tensor_name):
        tensor_name = tensor_name.split(":")[0]
        while tensor_name in self.alias:
            tensor_name = self.alias[tensor_name]
        return tensor_name

    def init(self, name, shape, values):
        self.inits.setdefault(name, tensor(name, shape, values))
        return name

    def add(self, op, inputs, output, shape, **attributes):
        self.nodes.append(node(op, inputs, output, **attributes))
        self.shapes[output] = list(shape)

    def order(self, outputs):
        """What the outputs need, in the order of computation."""
        done, seen = [], set()
        stack = [(name, False) for name in reversed(outputs)]
        while stack:
            name, is_ready = stack.pop()
            if is_ready:
                done.append(name)
            elif name not in seen:
                seen.add(name)
                stack.append((name, True))
                needs = [i.split(":")[0].lstrip("^") for i in self.graph[name].get("input") or []]
                stack.extend((need, False) for need in reversed(needs))
        return done

    def convert(self, outputs):
        for name in self.order(outputs):
            self.one(name, self.graph[name])
        infos = [value_info(self.name(o), self.shapes[self.name(o)]) for o in outputs]
        graph = field(1, self.nodes) + field(2, "centernet") + field(5, list(self.inits.values()))
        graph += field(11, value_info(self.input, self.shapes[self.input])) + field(12, infos)
        return field(1, 6) + field(2, "wad-cosim") + field(7, graph) + field(8, field(1, "") + field(2, 11))

    def one(self, name, n):
        op, attr = n["op"], n.get("attr", {})
        inputs = [i.split(":")[0] for i in n.get("input") or []]
        if op == "Const":
            return
        if op == "Placeholder":
            n_, h, w, c = (int(d["size"]) for d in attr["shape"]["shape"]["dim"])
            self.input, self.shapes[name] = name, [n_, c, h, w]
            return
        first = self.name(inputs[0])
        shape = self.shapes.get(first)
        if op == "Identity":
            self.alias[name] = first
        elif op in ("_FusedConv2D", "Conv2D", "DepthwiseConv2dNative", "FusedDepthwiseConv2dNative"):
            self.convolution(name, op, attr, inputs)
        elif op in ("Mul", "Add", "AddV2"):
            self.arithmetic(name, {"AddV2": "Add"}.get(op, op), inputs)
        elif op in ("Relu", "Sigmoid"):
            self.add(op, [first], name, shape)
        elif op == "Relu6":
            six = self.init("six", [1, 1, 1, 1], [6.0])
            self.add("HardSigmoid", [first], name + "/sixth", shape, alpha=1 / 6, beta=0.0)
            self.add("Mul", [name + "/sixth", six], name, shape)
        elif op == "Mean" and sorted(self.weights[inputs[1]][1]) == [1, 2]:
            self.add("GlobalAveragePool", [first], name, shape[:2] + [1, 1])
        elif op == "ConcatV2" and self.weights[inputs[-1]][1][0] in (3, -1):
            parts = [self.name(i) for i in inputs[:-1]]
            channels = sum(self.shapes[p][1] for p in parts)
            self.add("Concat", parts, name, [shape[0], channels] + shape[2:], axis=1)
        elif op == "ResizeBilinear":
            height, width = self.weights[inputs[1]][1]
            roi = self.init("no_roi", [0], [])
            scale = self.init(name + "/scale", [4], [1.0, 1.0, height / shape[2], width / shape[3]])
            centers = "half_pixel" if attr["half_pixel_centers"]["b"] else "asymmetric"
            self.add("Resize", [first, roi, scale], name, shape[:2] + [height, width],
                     mode="linear", coordinate_transformation_mode=centers)
        else:
            sys.exit(f"{name}: the operation {op} is not one that this script converts")

    def convolution(self, name, op, attr, inputs):
        fused = [base64.b64decode(f).decode() for f in attr.get("fused_ops", {}).get("list", {}).get("s", [])]
        if not set(fused) <= {"BiasAdd", "Relu"}:
            sys.exit(f"{name}: a convolution with {fused} is not one that this script converts")
        first = self.name(inputs[0])
        shape, (kernel_shape, kernel) = self.shapes[first], self.weights[inputs[1]]
        strides, dilations = ([int(i) for i in attr[k]["list"]["i"]][1:3] for k in ("strides", "dilations"))
        if "Depthwise" in op:
            height, width, group, multiplier = kernel_shape
            _, kernel = transposed(kernel_shape, kernel, (2, 3, 0, 1))
            out_shape = [group * multiplier, 1, height, width]
        else:
            out_shape, kernel = transposed(kernel_shape, kernel, (3, 2, 0, 1))
            group = 1
        is_same = base64.b64decode(attr["padding"]["s"]) == b"SAME"
        pads, size = [], []
        for side, k, stride, dilation in zip(shape[2:], out_shape[2:], strides, dilations):
            reach = (k - 1) * dilation + 1
            out = -(-side // stride) if is_same else (side - reach) // stride + 1
            pad = max((out - 1) * stride + reach - side, 0) if is_same else 0
            pads.append((pad // 2, pad - pad // 2))
            size.append(out)
        operands = [first, self.init(inputs[1], out_shape, kernel)]
        if "BiasAdd" in fused:
            operands.append(self.init(inputs[2], *self.weights[inputs[2]]))
        target = name + "/linear" if "Relu" in fused else name
        out = [shape[0], out_shape[0]] + size
        self.add("Conv", operands, target, out, kernel_shape=out_shape[2:], strides=strides,
                 dilations=dilations, group=group, pads=[p[0] for p in pads] + [p[1] for p in pads])
        if "Relu" in fused:
            self.add("Relu", [target], name, out)

    def arithmetic(self, name, op, inputs):
        """The larger operand first: OpenCV 4.6 broadcasts the second."""
        operands, largest = [], None
        for i in map(self.name, inputs):
            if i in self.weights:
                shape, values = self.weights[i]
                if len(shape) > 1 and prod(shape) > 1:
                    sys.exit(f"{name}: a constant of shape {shape} is not one that this script converts")
                operands.append(self.init(i + "/nchw", [1, prod(shape), 1, 1], values))
            else:
                operands.append(i)
                if largest is None or prod(self.shapes[i]) > prod(largest):
                    largest = self.shapes[i]
        if self.shapes.get(operands[0]) != largest:
            operands.reverse()
        self.add(op, operands, name, largest)


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    nodes, weights = read(sys.argv[1])
    with open(sys.argv[2], "wb") as file:
        file.write(Converter(nodes, weights).convert(OUTPUTS))


main()
