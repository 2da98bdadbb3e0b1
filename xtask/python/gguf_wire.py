"""The GGUF format, as far as our scripts need it: reads and writes version 3, little-endian.

Metadata is a list of (key, type, value), where the value of an array is (type of its items, list) and texts
are bytes. Tensors are a list of (name, dims, type, bytes); the first of `dims` varies fastest.
"""

import struct

MAGIC, VERSION, ALIGNMENT = b"GGUF", 3, 32

# Types of metadata.
UINT32, FLOAT32, BOOL, STRING, ARRAY = 4, 6, 7, 8, 9
FORMATS = {0: "B", 1: "b", 2: "H", 3: "h", 4: "I", 5: "i", 6: "f", 7: "?", 10: "Q", 11: "q", 12: "d"}

# Types of tensors: 32-bit floats; blocks of 32 8-bit integers that share a 16-bit scale.
F32, Q8_0 = 0, 8
Q8_0_BLOCK = struct.Struct("<e32b")


def read(path):
    """The metadata and the tensors of a file. Tensors are in the order of their bytes."""
    with open(path, "rb") as file:
        content = file.read()
    at = 0

    def number(format):
        nonlocal at
        (value,) = struct.unpack_from("<" + format, content, at)
        at += struct.calcsize("<" + format)
        return value

    def string():
        nonlocal at
        length = number("Q")
        at += length
        return content[at - length : at]

    def value(kind):
        if kind == STRING:
            return string()
        if kind == ARRAY:
            item, count = number("I"), number("Q")
            return item, [value(item) for _ in range(count)]
        return number(FORMATS[kind])

    if content[:4] != MAGIC:
        raise ValueError("it is no GGUF file")
    at = 4
    if number("I") != VERSION:
        raise ValueError("it is no GGUF file of version 3")
    tensors, keys = number("Q"), number("Q")
    metadata = []
    for _ in range(keys):
        key, kind = string(), number("I")
        metadata.append((key, kind, value(kind)))
    listed = []
    for _ in range(tensors):
        name, dims = string(), [number("Q") for _ in range(number("I"))]
        listed.append((name, dims, number("I"), number("Q")))
    listed.sort(key=lambda tensor: tensor[3])
    start = padded(at)
    ends = [offset for *_, offset in listed[1:]] + [len(content) - start]
    tensors = [
        (name, dims, kind, content[start + offset : start + end])
        for (name, dims, kind, offset), end in zip(listed, ends)
    ]
    return metadata, tensors


def write(path, metadata, tensors):
    """Writes a file."""
    head = bytearray(MAGIC + struct.pack("<IQQ", VERSION, len(tensors), len(metadata)))
    for key, kind, value in metadata:
        head += string(key) + struct.pack("<I", kind) + encoded(kind, value)
    offset = 0
    for name, dims, kind, data in tensors:
        head += string(name) + struct.pack(f"<I{len(dims)}QIQ", len(dims), *dims, kind, offset)
        offset += padded(len(data))
    with open(path, "wb") as file:
        for part in (head, *(data for *_, data in tensors)):
            file.write(part)
            file.write(bytes(padded(len(part)) - len(part)))


def padded(length):
    return -(-length // ALIGNMENT) * ALIGNMENT


def string(text):
    return struct.pack("<Q", len(text)) + text


def encoded(kind, value):
    if kind == STRING:
        return string(value)
    if kind == ARRAY:
        item, items = value
        return struct.pack("<IQ", item, len(items)) + b"".join(encoded(item, value) for value in items)
    return struct.pack("<" + FORMATS[kind], value)
