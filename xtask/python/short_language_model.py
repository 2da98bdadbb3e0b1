"""Keeps the first layers of SmolLM2 and names two tokens as models that see images have them.

    python3 short_language_model.py SMOLLM2.gguf OUTPUT.gguf LAYERS

llama.cpp puts `<fake_token_around_image>` and `<global-img>` around the tokens of an image of an idefics3
encoder (`vision_encoder.py` writes one) and looks them up in the vocabulary. Two tokens for source code, which
no text of ours contains, get these names. With few layers, answers come sooner and mean nothing: tests look at
what the server received.

Needs nothing but the standard library. The caller verifies the output's SHA-256 and renames it into place.
"""

import sys

import gguf_wire

NAMES = {b"<gh_stars>": b"<fake_token_around_image>", b"<issue_start>": b"<global-img>"}


def main(source, output, layers):
    metadata, tensors = gguf_wire.read(source)
    changed = []
    for key, kind, value in metadata:
        if key == b"llama.block_count":
            value = layers
        elif key == b"tokenizer.ggml.tokens":
            item, tokens = value
            value = item, [NAMES.get(token, token) for token in tokens]
        changed.append((key, kind, value))

    def kept(name):
        part, *rest = name.split(b".")
        return part != b"blk" or int(rest[0]) < layers

    gguf_wire.write(output, changed, [tensor for tensor in tensors if kept(tensor[0])])


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(f"usage: {sys.argv[0]} SMOLLM2.gguf OUTPUT.gguf LAYERS")
    try:
        main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
    except (OSError, ValueError) as error:
        sys.exit(f"cannot make {sys.argv[2]} from {sys.argv[1]}: {error}")
