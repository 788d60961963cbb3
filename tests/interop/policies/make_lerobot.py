"""Save a tiny policy with random weights: make_lerobot.py TYPE FOLDER, in LeRobot's environment.

SmolVLA stands on a language model that it names; here that is a folder beside it, with a tiny one of the same class.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from vlagents.policies.stack import import_stack

torch, factory, types = import_stack("lerobot", "torch", "lerobot.policies.factory", "lerobot.configs.types")

SMALL: dict[str, dict[str, Any]] = {
    "act": {
        "dim_model": 32, "n_heads": 2, "dim_feedforward": 64, "n_encoder_layers": 1, "chunk_size": 6,
        "n_action_steps": 6, "use_vae": False, "dropout": 0.0,
    },
    "diffusion": {
        "down_dims": (32, 64), "horizon": 8, "n_action_steps": 4, "num_train_timesteps": 8, "crop_shape": None,
        "diffusion_step_embed_dim": 16, "spatial_softmax_num_keypoints": 4,
    },
    "smolvla": {
        "load_vlm_weights": False, "num_vlm_layers": 2, "chunk_size": 6, "n_action_steps": 6, "num_steps": 2,
        "resize_imgs_with_padding": (64, 64), "tokenizer_max_length": 8,
    },
}  # fmt: skip
SPECIAL = {
    "image_token": "<image>", "fake_image_token": "<fake_token_around_image>", "global_image_token": "<global-img>",
    "end_of_utterance_token": "<end_of_utterance>",
}  # fmt: skip
MEAN, STD = 0.5, 0.01
"""Mean and standard deviation of actions: an output is near the mean only if it is brought back to physical units."""


def save_language_model(folder: Path) -> None:
    """Save what SmolVLA asks of its language model: configuration, words and processors."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast, SmolVLMConfig, SmolVLMImageProcessor, SmolVLMProcessor
    from transformers import SmolVLMVideoProcessor as VideoProcessor

    known = ["<pad>", "<unk>", "<s>", "</s>", *SPECIAL.values(), "pick", "up"]
    words = Tokenizer(models.WordLevel({word: number for number, word in enumerate(known)}, unk_token="<unk>"))
    words.pre_tokenizer = pre_tokenizers.Whitespace()
    special = {"pad_token": "<pad>", "unk_token": "<unk>", "bos_token": "<s>", "eos_token": "</s>"}
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=words, extra_special_tokens=SPECIAL, **special)
    size = {"hidden_size": 32, "intermediate_size": 64, "num_attention_heads": 2}
    config = SmolVLMConfig(
        vision_config={**size, "num_hidden_layers": 1, "image_size": 64, "patch_size": 16},
        text_config={**size, "model_type": "llama", "num_hidden_layers": 2, "num_key_value_heads": 2, "head_dim": 16}
        | {"vocab_size": 64, "pad_token_id": 0},
        scale_factor=2,
        image_token_id=known.index("<image>"),
        pad_token_id=0,
    )
    config.save_pretrained(folder)
    SmolVLMProcessor(SmolVLMImageProcessor(), tokenizer, VideoProcessor(), chat_template="-").save_pretrained(folder)


def main(kind: str, folder: str) -> None:
    """Save a policy of joints and a gripper, shown by one camera of 48 x 64 pixels."""
    torch.manual_seed(0)
    own: dict[str, Any] = {"pretrained_backbone_weights": None}
    if kind == "smolvla":
        own = {"vlm_model_name": str(Path(folder) / "language")}
        save_language_model(Path(folder) / "language")
    feature, has = types.PolicyFeature, types.FeatureType
    config = factory.make_policy_config(
        kind,
        device="cpu",
        input_features={
            "observation.state": feature(has.STATE, (8,)),
            "observation.images.wrist": feature(has.VISUAL, (3, 48, 64)),
        },
        output_features={"action": feature(has.ACTION, (8,))},
        **own,
        **SMALL[kind],
    )
    one = torch.ones(8)
    numbers = {"mean": one * MEAN, "std": one * STD, "min": one * (MEAN - STD), "max": one * (MEAN + STD)}
    colour = torch.ones(3, 1, 1)
    pictures = {"mean": colour / 2, "std": colour / 4, "min": colour * 0, "max": colour}
    stats = {"observation.state": numbers, "action": numbers, "observation.images.wrist": pictures}
    policy = factory.get_policy_class(kind)(config)
    policy.save_pretrained(folder)
    for processor in factory.make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(folder)
    print(f"{sum(each.numel() for each in policy.parameters())} weights")


main(*sys.argv[1:])
