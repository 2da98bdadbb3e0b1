"""Writes a ViT-B/16 with seeded random weights: the true size and cost of the paper's encoder, untrained.

    python3 vit_b16_untrained.py OUTPUT.onnx

For tests and timing only: its embeddings tell identical images from different ones and nothing more,
so it says "untrained" in its name, in its metadata and in the manifest. Shapes are those of ViT-B/16 at
224 x 224: patches of 16, 196 + 1 tokens, 12 layers, width 768, 12 heads, MLP 3072. Input
`pixel_values` (1, 3, 224, 224), output `tokens` (1, 197, 768), CLS first.

Needs nothing but the standard library. Weights come from SHAKE-256 of their own names, stored as int8
and scaled to float by the graph (ONNX Runtime folds that when it loads), so the file is a quarter of
the usual size, is the same on every machine, and its SHA-256 is pinned in assets/models.toml. The
caller verifies it and renames the file into place.
"""

import hashlib
import math
import struct
import sys

from onnx_wire import FLOAT, INT8, INT64, field, float_value, message, model, node, tensor

NAME = "vit-b16-untrained"
SIZE, PATCH, WIDTH, LAYERS, HEADS, HIDDEN = 224, 16, 768, 12, 12, 3072
SIDE = SIZE // PATCH
TOKENS = SIDE * SIDE + 1
HEAD_WIDTH = WIDTH // HEADS
OPSET = 20  # the first with Gelu


class Graph:
    """Nodes and initializers in the order they were asked for; every method returns a tensor's name."""

    def __init__(self):
        self.nodes, self.initializers = [], []

    def op(self, op_type, name, *inputs, **attributes):
        self.nodes.append(node(op_type, inputs, name, **attributes))
        return name

    def floats(self, name, values):
        raw = struct.pack(f"<{len(values)}f", *values)
        self.initializers.append(tensor(name, FLOAT, [len(values)], raw))
        return name

    def ints(self, name, values):
        raw = struct.pack(f"<{len(values)}q", *values)
        self.initializers.append(tensor(name, INT64, [len(values)], raw))
        return name

    def weight(self, name, dims, fan_in):
        """Seeded weights, uniform, of variance 1 / fan_in."""
        raw = hashlib.shake_256(f"{NAME}/{name}".encode()).digest(math.prod(dims))
        self.initializers.append(tensor(f"{name}.int8", INT8, dims, raw))
        scale = self.floats(f"{name}.scale", [math.sqrt(3.0 / fan_in) / 128.0])
        return self.op("Mul", name, self.op("Cast", f"{name}.float", f"{name}.int8", to=FLOAT), scale)

    def linear(self, name, x, fan_in, fan_out):
        product = self.op("MatMul", f"{name}.product", x, self.weight(f"{name}.weight", [fan_in, fan_out], fan_in))
        return self.op("Add", name, product, self.floats(f"{name}.bias", [0.0] * fan_out))

    def norm(self, name, x):
        scale, bias = self.floats(f"{name}.scale", [1.0] * WIDTH), self.floats(f"{name}.bias", [0.0] * WIDTH)
        return self.op("LayerNormalization", name, x, scale, bias, axis=-1, epsilon=1e-6)


def attention(g, name, x):
    def heads(part, order):
        flat = g.linear(f"{name}.{part}", x, WIDTH, WIDTH)
        split = g.op("Reshape", f"{name}.{part}.split", flat, "split_heads")
        return g.op("Transpose", f"{name}.{part}.heads", split, perm=order)

    query, value = heads("query", [0, 2, 1, 3]), heads("value", [0, 2, 1, 3])
    key = heads("key", [0, 2, 3, 1])
    scores = g.op("Mul", f"{name}.scores", g.op("MatMul", f"{name}.product", query, key), "attention_scale")
    weights = g.op("Softmax", f"{name}.weights", scores, axis=-1)
    mixed = g.op("MatMul", f"{name}.mixed", weights, value)
    joined = g.op("Transpose", f"{name}.joined", mixed, perm=[0, 2, 1, 3])
    flat = g.op("Reshape", f"{name}.flat", joined, "join_heads")
    return g.linear(f"{name}.out", flat, WIDTH, WIDTH)


def layer(g, name, x):
    attended = attention(g, f"{name}.attention", g.norm(f"{name}.norm1", x))
    x = g.op("Add", f"{name}.attended", x, attended)
    hidden = g.linear(f"{name}.mlp.in", g.norm(f"{name}.norm2", x), WIDTH, HIDDEN)
    out = g.linear(f"{name}.mlp.out", g.op("Gelu", f"{name}.mlp.gelu", hidden), HIDDEN, WIDTH)
    return g.op("Add", name, x, out)


def vit():
    g = Graph()
    g.ints("split_heads", [1, TOKENS, HEADS, HEAD_WIDTH])
    g.ints("join_heads", [1, TOKENS, WIDTH])
    g.floats("attention_scale", [1.0 / math.sqrt(HEAD_WIDTH)])
    kernel = g.weight("patch.weight", [WIDTH, 3, PATCH, PATCH], 3 * PATCH * PATCH)
    patches = g.op("Conv", "patch", "pixel_values", kernel, strides=[PATCH, PATCH])
    columns = g.op("Reshape", "patch.columns", patches, g.ints("patch.shape", [1, WIDTH, SIDE * SIDE]))
    rows = g.op("Transpose", "patch.rows", columns, perm=[0, 2, 1])
    tokens = g.op("Concat", "embed.tokens", g.weight("cls", [1, 1, WIDTH], 1), rows, axis=1)
    x = g.op("Add", "embed", tokens, g.weight("position", [1, TOKENS, WIDTH], 1))
    for index in range(LAYERS):
        x = layer(g, f"layer{index}", x)
    g.norm("tokens", x)
    return message(
        *(field(1, n) for n in g.nodes),
        field(2, NAME),
        *(field(5, t) for t in g.initializers),
        field(11, float_value("pixel_values", (1, 3, SIZE, SIZE))),
        field(12, float_value("tokens", (1, TOKENS, WIDTH))),
    )


def main(target):
    metadata = {"memtransfer.model": NAME, "memtransfer.trained": "false"}
    with open(target, "wb") as file:
        file.write(model(vit(), OPSET, "memtransfer", metadata))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"usage: {sys.argv[0]} OUTPUT.onnx")
    try:
        main(sys.argv[1])
    except OSError as error:
        sys.exit(f"cannot write {sys.argv[1]}: {error}")
