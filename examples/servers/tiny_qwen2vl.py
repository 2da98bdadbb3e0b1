"""Writes a tiny Qwen2-VL with seeded weights, which vLLM and transformers serve like the real one.

    python tiny_qwen2vl.py FOLDER TEXT...

The tokenizer is trained on the TEXT files. Like the real model, this one has 256 tokens for an image of 448 x 448
pixels: patches of 14 x 14, four of them a token. Its answers mean nothing.

Needs torch, torchvision and transformers; README.md has the versions.
"""

import sys

import torch
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers
from transformers import (
    GenerationConfig,
    Qwen2TokenizerFast,
    Qwen2VLConfig,
    Qwen2VLForConditionalGeneration,
    Qwen2VLImageProcessor,
    Qwen2VLProcessor,
    Qwen2VLVideoProcessor,
)

END_OF_TEXT, END = "<|endoftext|>", "<|im_end|>"
VISION = ["<|vision_start|>", "<|vision_end|>", "<|vision_pad|>", "<|image_pad|>", "<|video_pad|>"]
SPECIAL = [END_OF_TEXT, "<|im_start|>", END, *VISION]

# A message is plain text, or parts in order, as requests have them.
CHAT = """\
{%- for message in messages -%}
<|im_start|>{{ message.role }}
{% if message.content is string -%}
{{ message.content }}
{%- else -%}
{%- for part in message.content -%}
{%- if part.type == 'text' -%}{{ part.text }}{%- else -%}<|vision_start|><|image_pad|><|vision_end|>{%- endif -%}
{%- endfor -%}
{%- endif %}<|im_end|>
{% endfor -%}
{%- if add_generation_prompt -%}
<|im_start|>assistant
{% endif -%}"""


def tokenizer_of(folder, texts):
    trained = Tokenizer(models.BPE())
    trained.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    trained.decoder = decoders.ByteLevel()
    alphabet = pre_tokenizers.ByteLevel.alphabet()
    trainer = trainers.BpeTrainer(
        vocab_size=2000, special_tokens=SPECIAL, initial_alphabet=alphabet, show_progress=False
    )
    trained.train(texts, trainer)
    file = f"{folder}.tokenizer.json"
    trained.save(file)
    return Qwen2TokenizerFast(
        tokenizer_file=file, eos_token=END, pad_token=END_OF_TEXT, unk_token=None,
        additional_special_tokens=SPECIAL[1:], chat_template=CHAT,
    )


def main(folder, *texts):
    tokenizer = tokenizer_of(folder, list(texts))
    id_of = tokenizer.convert_tokens_to_ids
    ends = {"bos_token_id": id_of(END_OF_TEXT), "eos_token_id": id_of(END), "pad_token_id": id_of(END_OF_TEXT)}
    # vLLM's attention on the CPU needs heads that are 64 wide.
    rope = {"rope_type": "default", "type": "mrope", "mrope_section": [8, 12, 12], "rope_theta": 1e6}
    text = {
        "vocab_size": 2048, "hidden_size": 128, "intermediate_size": 256, "num_hidden_layers": 2,
        "num_attention_heads": 2, "num_key_value_heads": 1, "max_position_embeddings": 32768,
        "rope_scaling": rope, "rope_parameters": rope, "tie_word_embeddings": False, **ends,
    }
    vision = {
        "depth": 2, "embed_dim": 128, "hidden_size": 128, "num_heads": 2, "mlp_ratio": 2, "patch_size": 14,
        "spatial_merge_size": 2, "temporal_patch_size": 2,
    }
    config = Qwen2VLConfig(
        text_config=text, vision_config=vision, tie_word_embeddings=False,
        image_token_id=id_of("<|image_pad|>"), video_token_id=id_of("<|video_pad|>"),
        vision_start_token_id=id_of("<|vision_start|>"), vision_end_token_id=id_of("<|vision_end|>"),
    )
    torch.manual_seed(1)
    model = Qwen2VLForConditionalGeneration(config).float()
    with torch.no_grad():
        for weight in model.parameters():
            # With the usual small weights all images would lead to the same words.
            if weight.dim() > 1:
                weight.normal_(0, 0.15)
    model.generation_config = GenerationConfig(do_sample=False, max_new_tokens=64, **ends)
    model.save_pretrained(folder)
    processor = Qwen2VLProcessor(
        image_processor=Qwen2VLImageProcessor(min_pixels=56 * 56, max_pixels=1280 * 28 * 28),
        video_processor=Qwen2VLVideoProcessor(), tokenizer=tokenizer, chat_template=CHAT,
    )
    processor.save_pretrained(folder)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(f"usage: {sys.argv[0]} FOLDER TEXT...")
    main(*sys.argv[1:])
