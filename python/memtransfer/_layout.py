"""Reading and writing wire structs without ctypes: a field of a `ctypes.Structure` costs a Python call
each time, a `struct.Struct` takes all the fields that are wanted at once.

The formats are derived from the structures of `_wire`, so the layout is written down once.
"""

from __future__ import annotations

import ctypes
import struct

_CODES: dict[type, str] = {
    ctypes.c_uint8: "B",
    ctypes.c_uint16: "H",
    ctypes.c_uint32: "I",
    ctypes.c_uint64: "Q",
    ctypes.c_float: "f",
}


def layout(message: type[ctypes.Structure], *names: str) -> struct.Struct:
    """Takes the fields `names` (in the order of the message) out of a message's bytes, or puts them into
    one whose other bytes are zero. An array or structure is its bytes.
    """
    pieces, at = ["<"], 0
    fields: dict[str, type] = {field[0]: field[1] for field in message._fields_}
    for name in names:
        offset = getattr(message, name).offset
        size = ctypes.sizeof(fields[name])
        pieces += [f"{offset - at}x", _CODES.get(fields[name], f"{size}s")]
        at = offset + size
    pieces.append(f"{ctypes.sizeof(message) - at}x")
    return struct.Struct("".join(pieces))


def repeated(message: type[ctypes.Structure], most: int, *names: str) -> list[struct.Struct]:
    """For each count from 0 to `most`: takes the fields `names` out of so many messages in a row."""
    one = layout(message, *names).format.removeprefix("<")
    return [struct.Struct("<" + one * count) for count in range(most + 1)]


def place(message: type[ctypes.Structure], name: str) -> tuple[int, int]:
    """Where a field begins, and its bytes."""
    field = getattr(message, name)
    return field.offset, field.size
