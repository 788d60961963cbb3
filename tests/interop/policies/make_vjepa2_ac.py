"""Make a tiny V-JEPA 2-AC with random weights. Runs in its environment: make_vjepa2_ac.py FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

from vlagents.policies.stack import import_stack

torch, transformers, _ = import_stack("vjepa2_ac", "torch", "transformers", "timm")

from src.models.ac_predictor import vit_ac_predictor  # noqa: E402  after the operators that torchvision misses


def main(folder: Path) -> None:
    """Write the checkpoint."""
    torch.manual_seed(0)
    small = {"hidden_size": 48, "num_attention_heads": 2, "num_hidden_layers": 2}
    rest = {"pred_hidden_size": 48, "pred_num_attention_heads": 2, "pred_num_hidden_layers": 1, "num_pooler_layers": 1}
    encoder = transformers.VJEPA2Model(transformers.VJEPA2Config(crop_size=64, frames_per_clip=4, **small, **rest))
    encoder.save_pretrained(folder / "encoder")
    predictor = vit_ac_predictor(
        img_size=(64, 64), num_frames=8, embed_dim=48, predictor_embed_dim=48, depth=2, num_heads=2
    )
    # At the weights that training begins with, a motion changes the features by less than rounding does.
    with torch.no_grad():
        predictor.action_encoder.weight *= 200.0
        for block in predictor.predictor_blocks:
            for part in (block.attn.qkv, block.attn.proj, block.mlp.fc1, block.mlp.fc2):
                part.weight *= 8.0
    # As upstream's file: entries of a model that was trained on several devices.
    weights = {f"module.{name}": value for name, value in predictor.state_dict().items()}
    torch.save({"predictor": weights, "epoch": 1}, folder / "predictor.pt")
    print(sum(each.numel() for part in (encoder, predictor) for each in part.parameters()), "weights")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
