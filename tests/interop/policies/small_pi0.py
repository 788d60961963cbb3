"""A tiny π0 with random weights, in LeRobot's environment: `small_pi0.py make FOLDER`, or as `vlagents serve` with it.

LeRobot knows π0 in two sizes, of billions of weights; here its own class is built with small ones.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from vlagents.cli.main import main as vlagents
from vlagents.policies.stack import import_stack

torch, factory, types, pi0, tokens = import_stack(
    "lerobot",
    "torch",
    "lerobot.policies.factory",
    "lerobot.configs.types",
    "lerobot.policies.pi0.modeling_pi0",
    "lerobot.processor.tokenizer_processor",
)
TOKENIZER = "google/paligemma-3b-pt-224"
"""The tokenizer that LeRobot's processor of π0 requests; here it is a folder beside the weights."""


def shrink() -> None:
    """Have LeRobot build small models: of the language, of the actions, of the pictures."""
    usual, known, whole = pi0.get_gemma_config, pi0.CONFIG_MAPPING, pi0.PaliGemmaForConditionalGenerationWithPiGemma

    def small(variant: str) -> Any:
        config = usual(variant)
        config.width, config.depth, config.mlp_dim, config.head_dim = 32, 2, 64, 16
        config.num_heads, config.num_kv_heads = 2, 1
        return config

    class Known(dict[str, Any]):
        def __getitem__(self, name: str) -> Any:
            return paligemma if name == "paligemma" else known[name]

    def paligemma() -> Any:
        config = known["paligemma"]()
        seeing = config.vision_config
        seeing.hidden_size, seeing.num_hidden_layers, seeing.num_attention_heads, seeing.patch_size = 32, 1, 2, 32
        return config

    def built(config: Any) -> Any:
        config.vision_config.projection_dim = config.projection_dim = 32
        return whole(config=config)

    pi0.get_gemma_config, pi0.CONFIG_MAPPING = small, Known()
    pi0.PaliGemmaForConditionalGenerationWithPiGemma = built


def make(folder: Path) -> None:
    """Save a policy of joints and a gripper, shown by one camera of 48 x 64 pixels."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    torch.manual_seed(0)
    feature, has = types.PolicyFeature, types.FeatureType
    config = factory.make_policy_config(
        "pi0",
        device="cpu",
        dtype="float32",
        chunk_size=6,
        n_action_steps=6,
        num_inference_steps=2,
        compile_model=False,
        input_features={
            "observation.state": feature(has.STATE, (8,)),
            "observation.images.wrist": feature(has.VISUAL, (3, 48, 64)),
        },
        output_features={"action": feature(has.ACTION, (8,))},
    )
    policy = factory.get_policy_class("pi0")(config)
    policy.save_pretrained(folder)
    known = {word: number for number, word in enumerate(("<pad>", "<unk>", "<bos>", "<eos>", "pick", "up"))}
    words = Tokenizer(models.WordLevel(known, unk_token="<unk>"))
    words.pre_tokenizer = pre_tokenizers.Whitespace()
    special = {"pad_token": "<pad>", "unk_token": "<unk>", "bos_token": "<bos>", "eos_token": "<eos>"}
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=words, **special)
    tokenizer.save_pretrained(folder / "words")
    tokens.AutoTokenizer = type("AutoTokenizer", (), {"from_pretrained": lambda *_, **__: tokenizer})
    one = torch.ones(8)
    # The statistics: a mean of 0.5, and a hundredth around it.
    numbers = {"mean": one * 0.5, "std": one * 0.01, "min": one * 0.49, "max": one * 0.51}
    stats = {"observation.state": numbers, "action": numbers}
    for processor in factory.make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(folder)
    saved = folder / "policy_preprocessor.json"
    saved.write_text(saved.read_text().replace(TOKENIZER, str(folder / "words")))
    print(f"{sum(each.numel() for each in policy.parameters())} weights")


shrink()
if sys.argv[1] == "make":
    make(Path(sys.argv[2]))
else:
    sys.exit(vlagents(sys.argv[1:]))
