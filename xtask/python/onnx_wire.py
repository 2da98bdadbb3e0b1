"""Just enough of the ONNX file format to cut a graph and to write one; standard library only.

An ONNX file is one protobuf message. Reading it as raw fields, instead of through the `onnx` package,
keeps every byte that is not touched, so the result is the same on every machine and can be hashed.
Field numbers are those of onnx.proto (stable by protobuf's own rules).
"""

import struct

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5

FLOAT, INT8, INT64 = 1, 3, 7  # TensorProto.DataType


class Malformed(ValueError):
    """The bytes are not a protobuf message."""


def _read_varint(data, at):
    value, shift = 0, 0
    while True:
        if at >= len(data) or shift > 63:
            raise Malformed(f"a varint runs past its end at byte {at}")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if not byte & 0x80:
            return value, at
        shift += 7


def fields(message):
    """Yields (number, wire type, value) of a message; a `BYTES` value is a memoryview, not a copy."""
    data, at = memoryview(message), 0
    while at < len(data):
        key, at = _read_varint(data, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _read_varint(data, at)
        else:
            if kind == BYTES:
                size, at = _read_varint(data, at)
            elif kind in (FIXED32, FIXED64):
                size = 4 if kind == FIXED32 else 8
            else:
                raise Malformed(f"unknown wire type {kind} at byte {at}")
            if at + size > len(data):
                raise Malformed(f"field {number} runs past its message's end")
            value, at = data[at : at + size], at + size
        yield number, kind, value


def all_bytes(message, number):
    """Every value of a repeated bytes, text or message field."""
    return [bytes(value) for n, kind, value in fields(message) if n == number and kind == BYTES]


def text(message, number):
    """A text field, empty when absent."""
    return (all_bytes(message, number) or [b""])[-1].decode()


def _varint(value):
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number, value):
    """One encoded field: an int as varint, a float as 32 bits, str and bytes with their length."""
    if isinstance(value, int):
        return _varint(number << 3 | VARINT) + _varint(value)
    if isinstance(value, float):
        return _varint(number << 3 | FIXED32) + struct.pack("<f", value)
    value = value.encode() if isinstance(value, str) else value
    return b"".join((_varint(number << 3 | BYTES), _varint(len(value)), value))


def message(*parts):
    """Joins encoded fields."""
    return b"".join(parts)


# ---- The messages of onnx.proto that the scripts write -------------------------------------------


def attribute(name, value):
    """An attribute: int (may be negative), float or list of ints."""
    if isinstance(value, list):
        return message(field(1, name), *(field(8, v) for v in value), field(20, 7))
    if isinstance(value, float):
        return message(field(1, name), field(2, value), field(20, 1))
    return message(field(1, name), field(3, value % 2**64), field(20, 2))


def node(op_type, inputs, output, **attributes):
    """A node with one output, named after it."""
    return message(
        *(field(1, name) for name in inputs),
        field(2, output),
        field(3, output),
        field(4, op_type),
        *(field(5, attribute(name, value)) for name, value in sorted(attributes.items())),
    )


def tensor(name, data_type, dims, raw):
    """An initializer with little-endian `raw` contents."""
    return message(*(field(1, d) for d in dims), field(2, data_type), field(8, name), field(9, raw))


def float_value(name, dims):
    """A graph input or output: a float tensor of fixed shape."""
    shape = message(*(field(1, field(1, d)) for d in dims))
    return message(field(1, name), field(2, field(1, message(field(1, FLOAT), field(2, shape)))))


def model(graph, opset, producer, metadata):
    """A whole file. `metadata` is shown by every ONNX viewer and by the runtime."""
    return message(
        field(1, 8),  # ir_version
        field(2, producer),
        field(7, graph),
        field(8, message(field(1, ""), field(2, opset))),
        *(field(14, message(field(1, k), field(2, v))) for k, v in sorted(metadata.items())),
    )
