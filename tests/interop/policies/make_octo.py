"""Make a tiny Octo with random weights, as `save_pretrained` writes it, in Octo's environment: make_octo.py FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from octo.data.utils.text_processing import HFTokenizer
from octo.model.components.action_heads import DiffusionActionHead
from octo.model.components.tokenizers import ImageTokenizer, LanguageTokenizer, LowdimObsTokenizer
from octo.model.components.vit_encoders import SmallStem
from octo.model.octo_model import OctoModel
from octo.utils.spec import ModuleSpec
from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import PreTrainedTokenizerFast, T5Config

WINDOW, HORIZON, WORDS = 2, 4, 16


def language(folder: Path) -> dict:
    """Write a language encoder's configuration and a tokenizer; its name must have `t5` in it."""
    place = folder / "t5-tiny"
    T5Config(vocab_size=32, d_model=32, d_kv=16, d_ff=64, num_layers=1, num_heads=2).save_pretrained(place)
    words = ["[PAD]", "[UNK]", *["pick", "up", "push", "the", "green", "red", "cuboid"]]
    plain = Tokenizer(models.WordLevel({word: number for number, word in enumerate(words)}, unk_token="[UNK]"))
    plain.pre_tokenizer = pre_tokenizers.Whitespace()
    taken = ["input_ids", "attention_mask"]
    PreTrainedTokenizerFast(
        tokenizer_object=plain, pad_token="[PAD]", unk_token="[UNK]", model_input_names=taken
    ).save_pretrained(place)
    options = {"max_length": WORDS, "padding": "max_length", "truncation": True, "return_tensors": "np"}
    return ModuleSpec.create(HFTokenizer, tokenizer_name=str(place), encode_with_model=False, tokenizer_kwargs=options)


def pictures(name: str) -> dict:
    """Return what makes tokens of a camera's pictures. Channels are multiples of 32, which the norm's groups need."""
    stem = ModuleSpec.create(SmallStem, patch_size=16, features=(32, 32, 32, 32), num_features=32)
    return ModuleSpec.create(ImageTokenizer, obs_stack_keys=[name], task_stack_keys=[name], encoder=stem)


def main(folder: Path) -> None:
    """Write the checkpoint."""
    text = language(folder.parent)
    model = {
        "observation_tokenizers": {
            "primary": pictures("image_primary"),
            "wrist": pictures("image_wrist"),
            "proprio": ModuleSpec.create(LowdimObsTokenizer, n_bins=64, low=-2.0, high=2.0, obs_keys=["proprio"]),
        },
        "task_tokenizers": {"language": ModuleSpec.create(LanguageTokenizer, encoder=str(folder.parent / "t5-tiny"))},
        "heads": {
            "action": ModuleSpec.create(
                DiffusionActionHead, readout_key="readout_action", action_horizon=HORIZON, action_dim=7, hidden_dim=32
            )
        },
        "readouts": {"action": 1},
        "token_embedding_size": 32,
        "transformer_kwargs": {
            "num_layers": 1,
            "mlp_dim": 64,
            "num_attention_heads": 2,
            "dropout_rate": 0.0,
            "add_position_embedding": False,
        },
        "max_horizon": 10,
        "repeat_task_tokens": True,
    }
    shapes = {"image_primary": (64, 64, 3), "image_wrist": (32, 32, 3)}
    present = np.ones((1, WINDOW), bool)
    seen = {name: np.zeros((1, WINDOW, *shape), np.uint8) for name, shape in shapes.items()}
    seen |= {"proprio": np.zeros((1, WINDOW, 8), np.float32), "timestep": np.zeros((1, WINDOW), np.int32)}
    seen |= {"timestep_pad_mask": present, "pad_mask_dict": dict.fromkeys(seen, present)}
    tokens = HFTokenizer(**text["kwargs"]).encode([""])
    wanted = {name: np.zeros((1, *shape), np.uint8) for name, shape in shapes.items()}
    wanted |= {"language_instruction": {name: np.asarray(tokens[name]) for name in ("input_ids", "attention_mask")}}
    wanted |= {"pad_mask_dict": {name: np.ones(1, bool) for name in wanted}}
    # Statistics of different size, so that a test can tell whose were taken.
    spread = np.array([0.01] * 3 + [0.1] * 3 + [0.5])
    statistics = {
        name: {
            "action": {"mean": np.arange(7) * factor, "std": spread * factor, "mask": np.array([True] * 6 + [False])},
            "proprio": {"mean": np.zeros(8), "std": np.ones(8)},
        }
        for name, factor in (("small", 1.0), ("large", 1000.0))
    }
    made = OctoModel.from_config(
        {"model": model, "text_processor": text},
        {"observation": seen, "task": wanted, "action": np.zeros((1, WINDOW, HORIZON, 7), np.float32)},
        HFTokenizer(**text["kwargs"]),
        dataset_statistics=statistics,
    )
    made.save_pretrained(0, str(folder.resolve()))
    print(sum(np.size(leaf) for leaf in __import__("jax").tree_util.tree_leaves(made.params)), "weights")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
