"""Octo's config of fine-tuning for a dataset, which its `scripts/finetune.py` reads.

Octo reads RLDS. Our export has what Octo expects of a trajectory: `action`, `observation`, `language_instruction`, and
a gripper that is 1 when it is open; so nothing has to be standardised.
"""

from __future__ import annotations

from pprint import pformat
from string import Template

from rcs_data.finetune.contents import Contents
from rcs_data.finetune.written import Written, facts

FILE = "octo_config.py"
HORIZON, WINDOW = 4, 2
PRETRAINED_SIZE = 7
"""Numbers of an action of the published models; another number needs a new head."""


def octo(contents: Contents) -> Written:
    """Return Octo's configuration.

    Raises:
        InvalidSetup: There is no camera.
    """
    wrist = next(iter(contents.wrist_cameras), None)
    images = {"primary": column(contents.scene_camera), "wrist": None if wrist is None else column(wrist)}
    text = Template(_TEXT).substitute(
        name=repr(contents.name),
        facts=facts(contents),
        images=pformat(images, sort_dicts=False),
        mask=repr(contents.arm_mask),
        action_size=contents.action_size,
        horizon=HORIZON,
        window=WINDOW,
        pretrained=PRETRAINED_SIZE,
    )
    cameras = {"image_primary": contents.scene_camera} | ({} if wrist is None else {"image_wrist": wrist})
    return Written(
        files={FILE: text, "vlagents.json": contents.settings(images=cameras, has_state=False)},
        export_format="rlds",
        steps=(
            f"rcs-data export DATASET --format rlds --name {contents.name} --out EXPORTS",
            f"OCTO_REPO=OCTO python OCTO/scripts/finetune.py --config FOLDER/{FILE}:full,language_conditioned "
            "--config.pretrained_path=hf://rail-berkeley/octo-base-1.5 --config.dataset_kwargs.data_dir=EXPORTS "
            "--config.save_dir=RUN",
            "vlagents serve octo --checkpoint RUN/octo_finetune/EXPERIMENT --settings FOLDER/vlagents.json",
        ),
    )


def column(camera: str) -> str:
    """Return the name of a camera's pictures in our RLDS."""
    return f"image_{camera.replace('/', '_')}"


_TEXT = '''"""Octo's config of a dataset, written by `rcs-data recipe octo`. OCTO_REPO is the folder of a checkout."""

import os
import runpy

from octo.model.components.action_heads import DiffusionActionHead
from octo.utils.spec import ModuleSpec

${facts}

ACTION_SIZE = ${action_size}
HORIZON = ${horizon}
IMAGES = ${images}
# Which numbers of an action are normalised: not those of grippers and hands, which are between 0 and 1.
MASK = ${mask}


def get_config(config_string="full,language_conditioned"):
    """Return Octo's own config for fine-tuning, with this dataset in it."""
    upstream = os.path.join(os.environ["OCTO_REPO"], "scripts", "configs", "finetune_config.py")
    config = runpy.run_path(upstream)["get_config"](config_string)
    with config.unlocked():
        config.dataset_kwargs = {
            "name": ${name},
            "data_dir": "EXPORTS",
            "image_obs_keys": IMAGES,
            # The published models were trained without the robot's state.
            "proprio_obs_key": None,
            "language_key": "language_instruction",
            "action_proprio_normalization_type": "normal",
            "action_normalization_mask": MASK,
        }
        config.window_size = ${window}
        config.traj_transform_kwargs.window_size = ${window}
        config.traj_transform_kwargs.action_horizon = HORIZON
        if IMAGES["wrist"] is None:
            config.config_delete_keys = {"model": {"observation_tokenizers": {"wrist": None}}}
            del config.frame_transform_kwargs.resize_size["wrist"]
            del config.frame_transform_kwargs.image_augment_kwargs["wrist"]
        if ACTION_SIZE != ${pretrained}:
            # Another robot's actions: the published head does not fit, and begins anew.
            head = ModuleSpec.create(
                DiffusionActionHead,
                readout_key="readout_action",
                use_map=False,
                action_horizon=HORIZON,
                action_dim=ACTION_SIZE,
                n_diffusion_samples=1,
                dropout_rate=0.0,
            )
            config.update_config = {"model": {"heads": {"action": head}}}
    return config
'''
