"""Make a tiny OpenVLA with random weights, as Transformers saves it: make_openvla.py FOLDER, in OpenVLA's environment.

The classes come from a checkout of openvla/openvla (OPENVLA_REPO). Saving copies their files into the checkpoint, as
published ones have them.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
from vlagents.policies.stack import import_stack

torch, transformers, _ = import_stack("openvla", "torch", "transformers", "timm")
# Not by way of the package around it, which imports what only training needs.
sys.path.insert(0, str(Path(os.environ["OPENVLA_REPO"]) / "prismatic" / "extern"))

from hf.configuration_prismatic import OpenVLAConfig  # noqa: E402
from hf.modeling_prismatic import OpenVLAForActionPrediction  # noqa: E402
from hf.processing_prismatic import PrismaticImageProcessor, PrismaticProcessor  # noqa: E402
from tokenizers import Tokenizer, models, pre_tokenizers, processors  # noqa: E402

TOKENS = 32_000
"""Number of tokens of Llama 2: the model's code names some of its tokens by number."""


def tokenizer() -> transformers.PreTrainedTokenizerFast:
    """Return a tokenizer that gives words numbers below those of actions, and begins with 1 as Llama's does."""
    spoken = "in : out what action should the robot take to pick up push green red cuboid ?"
    words = ["<unk>", "<s>", "</s>", *spoken.split(" ")]
    plain = Tokenizer(models.WordLevel({word: number for number, word in enumerate(words)}, unk_token="<unk>"))
    plain.pre_tokenizer = pre_tokenizers.Whitespace()
    plain.post_processor = processors.TemplateProcessing(single="<s> $A", special_tokens=[("<s>", 1)])
    names = ["input_ids", "attention_mask"]
    made = transformers.PreTrainedTokenizerFast(
        tokenizer_object=plain, unk_token="<unk>", bos_token="<s>", eos_token="</s>", model_input_names=names
    )
    made.add_special_tokens({"pad_token": "<PAD>"})
    return made


def statistics(low: float, high: float) -> dict:
    """Return a dataset's statistics: the gripper is left as it is."""
    return {"action": {"q01": [low] * 6 + [0.0], "q99": [high] * 6 + [1.0], "mask": [True] * 6 + [False]}}


def main(folder: Path) -> None:
    """Write the checkpoint."""
    torch.manual_seed(0)
    config = OpenVLAConfig(
        vision_backbone_id="siglip-vit-so400m",
        llm_backbone_id="llama2-7b-pure",
        arch_specifier="no-align+gelu-mlp",
        image_resize_strategy="resize-naive",
        timm_model_ids=["vit_tiny_patch16_224"],
        timm_override_act_layers=[None],
        image_sizes=[64],
        norm_stats={"small": statistics(-0.01, 0.01), "large": statistics(-10.0, 10.0)},
        text_config={
            "vocab_size": TOKENS + 64,
            "hidden_size": 64,
            "intermediate_size": 64,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
        },
    )
    model = OpenVLAForActionPrediction(config)
    # A random language model would say what is no action: let only tokens of actions be likely.
    with torch.no_grad():
        head = model.language_model.lm_head.weight
        head[: TOKENS - 256] *= 1e-3
        head[TOKENS - 256 :] *= 50.0
    images = PrismaticImageProcessor(
        image_resize_strategy="resize-naive", input_sizes=[(3, 64, 64)], interpolations=["bicubic"]
    )
    processor = PrismaticProcessor(image_processor=images, tokenizer=tokenizer())
    OpenVLAConfig.register_for_auto_class()
    PrismaticImageProcessor.register_for_auto_class("AutoImageProcessor")
    PrismaticProcessor.register_for_auto_class("AutoProcessor")
    OpenVLAForActionPrediction.register_for_auto_class("AutoModelForVision2Seq")
    for part in (model, images, processor):
        part.save_pretrained(folder)
    (folder / "dataset_statistics.json").write_text(json.dumps(config.norm_stats))
    print(sum(int(np.prod(weight.shape)) for weight in model.parameters()), "weights")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
