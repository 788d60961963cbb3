"""openpi's TrainConfig for a dataset: pi0, pi0.5 or pi0-FAST, fine-tuned from the published base.

openpi reads LeRobot's format 2.1, and finds configs by name in a table; the file that is written adds its own to it and
then runs openpi's programs. Keys on the robot's side are those of vlagents' layout "own".
"""

from __future__ import annotations

from pprint import pformat
from string import Template
from typing import Literal

from rcs_data.errors import InvalidSetup
from rcs_data.finetune.contents import Contents
from rcs_data.finetune.written import Written, facts

Base = Literal["pi0", "pi05", "pi0_fast"]
FILE = "openpi_config.py"
SLOTS = ("base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb")
"""Pictures that the models see."""
HORIZON = 16

_MODELS: dict[str, str] = {
    "pi0": f"pi0_config.Pi0Config(action_horizon={HORIZON})",
    "pi05": f"pi0_config.Pi0Config(pi05=True, action_horizon={HORIZON})",
    "pi0_fast": f"pi0_fast.Pi0FASTConfig(action_dim=ACTION_SIZE, action_horizon={HORIZON})",
}


def openpi(contents: Contents, base: Base = "pi05") -> Written:
    """Return openpi's configuration, which begins with a published model.

    Raises:
        InvalidSetup: There are no cameras or more than three, or there is no such model.
    """
    if base not in _MODELS:
        raise InvalidSetup(f"base is {base!r}; valid are {', '.join(_MODELS)}.")
    slots = _slots(contents)
    text = Template(_TEXT).substitute(
        name=repr(f"rcs_{contents.name}"),
        repo=repr(f"rcs/{contents.name}"),
        facts=facts(contents),
        state_size=contents.state_size,
        action_size=contents.action_size,
        slots=pformat(slots, sort_dicts=False),
        columns=pformat({key(camera): column(camera) for camera in contents.cameras}, sort_dicts=False),
        delta=repr(_delta_mask(contents)),
        model=_MODELS[base],
        weights=repr(f"gs://openpi-assets/checkpoints/{base}_base/params"),
    )
    settings = contents.settings(
        images={key(camera): camera for camera in contents.cameras}, has_state=True, layout="own", config=FILE
    )
    name = f"rcs_{contents.name}"
    return Written(
        files={FILE: text, "vlagents.json": settings},
        export_format="lerobot-v2.1",
        steps=(
            f"rcs-data export DATASET --format lerobot-v2.1 --out $HF_LEROBOT_HOME/rcs/{contents.name}",
            f"python FOLDER/{FILE} OPENPI/scripts/compute_norm_stats.py --config-name {name}",
            f"python FOLDER/{FILE} OPENPI/scripts/train.py {name} --exp-name first",
            f"cp FOLDER/{FILE} FOLDER/vlagents.json checkpoints/{name}/first/STEP",
            f"vlagents serve openpi --checkpoint checkpoints/{name}/first/STEP",
        ),
    )


def key(camera: str) -> str:
    """Return openpi's key of a camera's picture."""
    return f"observation/{camera}"


def column(camera: str) -> str:
    """Return LeRobot's column of a camera, as our export has it."""
    return f"observation.images.{camera.replace('/', '.')}"


def _slots(contents: Contents) -> dict[str, str]:
    """Return the key of each picture that the model sees: the scene first, then wrists, then other cameras."""
    scene = contents.scene_camera
    rest = [*contents.wrist_cameras, *(name for name in contents.cameras if name not in contents.wrist_cameras)]
    order = [scene, *(name for name in rest if name != scene)]
    if len(order) > len(SLOTS):
        raise InvalidSetup(
            f"The dataset has {len(order)} cameras ({', '.join(contents.cameras)}), and openpi's models see three; "
            "choose with --cameras."
        )
    return {slot: key(camera) for slot, camera in zip(SLOTS, order, strict=False)}


def _delta_mask(contents: Contents) -> list[bool] | None:
    """Return which numbers of an action become relative to the state, for the models learn that best; None for none.

    Those are absolute joints that the state has in the same place. openpi subtracts number by number, so poses with
    quaternions or angles that wrap stay as they are.
    """
    mask: list[bool] = []
    for index, part in enumerate(contents.action):
        same = index < len(contents.state) and contents.state[index].name == part.name
        same = same and contents.state[index].size == part.size
        is_joints = part.name.rpartition("/")[2] == "joints" and part.meaning == "absolute"
        mask += [bool(same and is_joints)] * part.size
        if not same:  # what follows is in another place
            break
    # openpi leaves numbers beyond the mask as they are.
    while mask and not mask[-1]:
        del mask[-1]
    return mask or None


_TEXT = '''"""openpi's config of a dataset, written by `rcs-data recipe openpi`.

    python openpi_config.py OPENPI/scripts/compute_norm_stats.py --config-name ${name}
    python openpi_config.py OPENPI/scripts/train.py ${name} --exp-name first
"""

import dataclasses
import pathlib
import runpy
import sys

import numpy as np
import openpi.models.model as models
from openpi import transforms
from openpi.models import pi0_config, pi0_fast
from openpi.training import config as configs
from openpi.training import weight_loaders

${facts}

REPO = ${repo}  # below HF_LEROBOT_HOME
STATE_SIZE = ${state_size}
ACTION_SIZE = ${action_size}
# The model's pictures, by our key; what is missing is black.
SLOTS = ${slots}
# Our keys, by column of the dataset.
COLUMNS = ${columns}
# Which numbers of an action the model learns relative to the state.
DELTA = ${delta}


def as_picture(values):
    """Return (height, width, 3) of uint8; LeRobot's are (3, height, width) from 0 to 1."""
    image = np.asarray(values)
    if np.issubdtype(image.dtype, np.floating):
        image = (255 * image).astype(np.uint8)
    return np.moveaxis(image, 0, -1) if image.shape[0] == 3 else image


@dataclasses.dataclass(frozen=True)
class Inputs(transforms.DataTransformFn):
    model_type: models.ModelType

    def __call__(self, data):
        shown = {slot: as_picture(data[key]) for slot, key in SLOTS.items()}
        black = np.zeros_like(next(iter(shown.values())))
        names = ("base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb")
        # pi0-FAST was trained without masks.
        sees_all = self.model_type == models.ModelType.PI0_FAST
        found = {
            "state": np.asarray(data["observation/state"]),
            "image": {name: shown.get(name, black) for name in names},
            "image_mask": {name: np.bool_(sees_all or name in shown) for name in names},
        }
        return found | {name: data[name] for name in ("actions", "prompt") if name in data}


@dataclasses.dataclass(frozen=True)
class Outputs(transforms.DataTransformFn):
    def __call__(self, data):
        return {"actions": np.asarray(data["actions"])[:, :ACTION_SIZE]}


@dataclasses.dataclass(frozen=True)
class Data(configs.DataConfigFactory):
    def create(self, assets_dirs: pathlib.Path, model_config: models.BaseModelConfig) -> configs.DataConfig:
        columns = {**COLUMNS, "observation/state": "observation.state", "actions": "action", "prompt": "prompt"}
        ours = transforms.Group(inputs=[Inputs(model_config.model_type)], outputs=[Outputs()])
        if DELTA is not None:
            ours = ours.push(inputs=[transforms.DeltaActions(DELTA)], outputs=[transforms.AbsoluteActions(DELTA)])
        return dataclasses.replace(
            self.create_base_config(assets_dirs, model_config),
            repack_transforms=transforms.Group(inputs=[transforms.RepackTransform(columns)]),
            data_transforms=ours,
            model_transforms=configs.ModelTransformFactory()(model_config),
            action_sequence_keys=("action",),
        )


CONFIG = configs.TrainConfig(
    name=${name},
    model=${model},
    data=Data(repo_id=REPO, base_config=configs.DataConfig(prompt_from_task=True)),
    weight_loader=weight_loaders.CheckpointWeightLoader(${weights}),
    num_train_steps=30_000,
)

if __name__ == "__main__":
    # By its own name, so that the processes that load data find its classes.
    import openpi_config

    configs._CONFIGS_DICT[CONFIG.name] = openpi_config.CONFIG
    del sys.argv[0]
    runpy.run_path(sys.argv[0], run_name="__main__")
'''
