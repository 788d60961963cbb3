"""Save a tiny policy with random weights: make_lerobot.py TYPE FOLDER, in LeRobot's environment."""

from __future__ import annotations

import sys
from typing import Any

from vlagents.policies.torch_stack import import_stack

torch, factory, types = import_stack("lerobot", "lerobot.policies.factory", "lerobot.configs.types")

SMALL: dict[str, dict[str, Any]] = {
    "act": {
        "dim_model": 32, "n_heads": 2, "dim_feedforward": 64, "n_encoder_layers": 1, "chunk_size": 6,
        "n_action_steps": 6, "use_vae": False, "dropout": 0.0,
    },
    "diffusion": {
        "down_dims": (32, 64), "horizon": 8, "n_action_steps": 4, "num_train_timesteps": 8, "crop_shape": None,
        "diffusion_step_embed_dim": 16, "spatial_softmax_num_keypoints": 4,
    },
}  # fmt: skip
MEAN, STD = 0.5, 0.01
"""Of the actions: what comes out is near the mean only if it is brought back to physical units."""


def main(kind: str, folder: str) -> None:
    """Save a policy of joints and a gripper, shown by one camera of 48 x 64 pixels."""
    torch.manual_seed(0)
    feature, has = types.PolicyFeature, types.FeatureType
    config = factory.make_policy_config(
        kind,
        device="cpu",
        pretrained_backbone_weights=None,
        input_features={
            "observation.state": feature(has.STATE, (8,)),
            "observation.images.wrist": feature(has.VISUAL, (3, 48, 64)),
        },
        output_features={"action": feature(has.ACTION, (8,))},
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
