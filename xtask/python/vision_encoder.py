"""Writes an encoder that lets SmolLM2 see colours: an mmproj file of llama.cpp, of the type idefics3.

    python3 vision_encoder.py SMOLLM2.gguf OUTPUT.gguf

No pretrained vision-language model is as small as tests need it. This one has the parts of a real one (patches,
positions, a transformer layer, a projection), so images pass through all of a server's code, and seeded weights.
What it tells the language model depends on the pixels: the mean colour of an image becomes a mixture of the
model's own embeddings of " red", " green", " blue" and " gray".

- The first three channels of a patch are its mean red, green and blue from -1 to 1. The last two are large
  constants of opposite signs, so that every LayerNorm divides by nearly the same number (`DEVIATION`).
- The transformer layer adds little to what it is given.
- The projection averages the patches and maps (1, red, green, blue) to an embedding: a pure colour to that of
  its word, and gray (0, 0, 0) to that of " gray".

Needs nothing but the standard library. Weights come from SHAKE-256 of their own names, so the file is the same
on every machine. The caller verifies its SHA-256 and renames it into place.
"""

import array
import hashlib
import math
import sys

import gguf_wire
from gguf_wire import ARRAY, BOOL, F32, FLOAT32, Q8_0, Q8_0_BLOCK, STRING, UINT32

SIZE, PATCH, MERGE, WIDTH, HIDDEN, HEADS = 128, 32, 4, 192, 768, 3
PATCHES = (SIZE // PATCH) ** 2
CONSTANT = 20.0
DEVIATION = math.sqrt(2 * CONSTANT**2 / WIDTH)


def floats(values):
    values = array.array("f", values)
    if sys.byteorder == "big":
        values.byteswap()
    return values.tobytes()


def seeded(name, count, most):
    """`count` numbers from -most to most."""
    drawn = hashlib.shake_256(f"vision-encoder/{name}".encode()).digest(count)
    return [(byte - 127.5) / 127.5 * most for byte in drawn]


def word_embeddings(path, words):
    """The embedding of each word, with a space before it."""
    metadata, tensors = gguf_wire.read(path)
    _, tokens = next(value for key, _, value in metadata if key == b"tokenizer.ggml.tokens")
    _, (width, _), kind, table = next(tensor for tensor in tensors if tensor[0] == b"token_embd.weight")
    if kind != Q8_0:
        raise ValueError("its embeddings are not of the type Q8_0")
    row_bytes = width // 32 * Q8_0_BLOCK.size
    for word in words:
        row = tokens.index("\u0120".encode() + word.encode()) * row_bytes
        blocks = Q8_0_BLOCK.iter_unpack(table[row : row + row_bytes])
        yield [scale * value for scale, *block in blocks for value in block]


def patch_weights():
    """Three colours of PATCH x PATCH pixels for each channel of the width."""
    weights = seeded("patch", WIDTH * 3 * PATCH**2, 1e-4)
    for channel in (0, 1, 2, WIDTH - 2, WIDTH - 1):
        for colour in range(3):
            start = (channel * 3 + colour) * PATCH**2
            weights[start : start + PATCH**2] = [float(channel == colour) / PATCH**2] * PATCH**2
    return weights


def projection(red, green, blue, gray):
    """For each channel of an embedding, MERGE x MERGE patches of WIDTH."""
    rows = []
    for r, g, b, constant in zip(red, green, blue, gray):
        # The weights w of (1, red, green, blue) that map (1, 1, -1, -1) to r, and so on, and (1, 0, 0, 0) to gray:
        # r + g = 2 (w[0] - w[3]).
        row = [constant - (g + b) / 2, constant - (r + b) / 2, constant - (r + g) / 2]
        row += [0.0] * (WIDTH - 3)
        row[WIDTH - 2] = constant / CONSTANT
        rows += [value * DEVIATION / MERGE**2 for value in row] * MERGE**2
    return rows


def main(source, output):
    embeddings = list(word_embeddings(source, ["red", "green", "blue", "gray"]))
    width = len(embeddings[0])
    metadata = [
        (b"general.architecture", STRING, b"clip"),
        (b"general.type", STRING, b"mmproj"),
        (b"general.name", STRING, b"colours, with seeded weights"),
        (b"general.file_type", UINT32, 0),
        (b"clip.has_vision_encoder", BOOL, True),
        (b"clip.projector_type", STRING, b"idefics3"),
        (b"clip.use_gelu", BOOL, True),
        (b"clip.vision.image_size", UINT32, SIZE),
        (b"clip.vision.preproc_image_size", UINT32, SIZE),
        (b"clip.vision.patch_size", UINT32, PATCH),
        (b"clip.vision.embedding_length", UINT32, WIDTH),
        (b"clip.vision.feed_forward_length", UINT32, HIDDEN),
        (b"clip.vision.block_count", UINT32, 1),
        (b"clip.vision.attention.head_count", UINT32, HEADS),
        (b"clip.vision.attention.layer_norm_epsilon", FLOAT32, 1e-6),
        (b"clip.vision.projection_dim", UINT32, width),
        (b"clip.vision.projector.scale_factor", UINT32, MERGE),
        (b"clip.vision.image_mean", ARRAY, (FLOAT32, [0.5] * 3)),
        (b"clip.vision.image_std", ARRAY, (FLOAT32, [0.5] * 3)),
    ]
    tensors = []

    def add(name, dims, values):
        tensors.append((name.encode(), dims, F32, floats(values)))

    def linear(name, inputs, outputs, most):
        add(f"{name}.weight", [inputs, outputs], seeded(name, inputs * outputs, most))
        add(f"{name}.bias", [outputs], [0.0] * outputs)

    def norm(name):
        add(f"{name}.weight", [WIDTH], [1.0] * WIDTH)
        add(f"{name}.bias", [WIDTH], [0.0] * WIDTH)

    add("v.patch_embd.weight", [PATCH, PATCH, 3, WIDTH], patch_weights())
    add("v.patch_embd.bias", [WIDTH], [0.0] * (WIDTH - 2) + [CONSTANT, -CONSTANT])
    add("v.position_embd.weight", [WIDTH, PATCHES], seeded("position", WIDTH * PATCHES, 0.003))
    norm("v.blk.0.ln1")
    for part in ("attn_q", "attn_k", "attn_v"):
        linear(f"v.blk.0.{part}", WIDTH, WIDTH, 0.03)
    linear("v.blk.0.attn_out", WIDTH, WIDTH, 0.001)
    norm("v.blk.0.ln2")
    linear("v.blk.0.ffn_up", WIDTH, HIDDEN, 0.03)
    linear("v.blk.0.ffn_down", HIDDEN, WIDTH, 0.001)
    norm("v.post_ln")
    add("mm.model.fc.weight", [MERGE**2 * WIDTH, width], projection(*embeddings))
    gguf_wire.write(output, metadata, tensors)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(f"usage: {sys.argv[0]} SMOLLM2.gguf OUTPUT.gguf")
    try:
        main(*sys.argv[1:])
    except (OSError, ValueError) as error:
        sys.exit(f"cannot make {sys.argv[2]} from {sys.argv[1]}: {error}")
