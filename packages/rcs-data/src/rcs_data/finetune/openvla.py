"""OpenVLA's registration of a dataset, and the start of its `vla-scripts/finetune.py` with it.

OpenVLA reads RLDS, and loads only actions that are how far the TCP goes, with a gripper: (x, y, z, roll, pitch, yaw)
[m, rad] and 0 closed to 1 open. That is `xyzrpy`, relative to the last step, and `gripper`.
"""

from __future__ import annotations

from string import Template

from rcs_data.errors import InvalidSetup
from rcs_data.finetune.contents import POSE, Contents
from rcs_data.finetune.octo import column
from rcs_data.finetune.written import Written, facts

FILE = "openvla_dataset.py"


def openvla(contents: Contents) -> Written:
    """Return OpenVLA's registration.

    Raises:
        InvalidSetup: The dataset's actions are not those that OpenVLA loads, or there is no camera.
    """
    action = [(part.name.rpartition("/")[2], part.meaning) for part in contents.action]
    if action != [(POSE, "delta"), ("gripper", "absolute")]:
        came = ", ".join(f"{part.name} ({part.meaning})" for part in contents.action)
        raise InvalidSetup(
            f"OpenVLA loads actions that are xyzrpy relative to the last step and gripper; this dataset has {came}. "
            "Collect with --control xyzrpy, and without --relative absolute."
        )
    text = Template(_TEXT).substitute(
        name=repr(contents.name), facts=facts(contents), image=repr(column(contents.scene_camera))
    )
    settings = contents.settings(images={"image": contents.scene_camera}, has_state=False, center_crop=True)
    return Written(
        files={FILE: text, "vlagents.json": settings},
        export_format="rlds",
        steps=(
            f"rcs-data export DATASET --format rlds --name {contents.name} --out EXPORTS",
            f"cd OPENVLA && torchrun --standalone --nproc-per-node 1 FOLDER/{FILE} vla-scripts/finetune.py "
            f"--vla_path openvla/openvla-7b --data_root_dir EXPORTS --dataset_name {contents.name} --run_root_dir RUNS",
            "vlagents serve openvla --checkpoint RUNS/RUN --settings FOLDER/vlagents.json",
        ),
    )


_TEXT = '''"""OpenVLA's registration of a dataset, written by `rcs-data recipe openvla`.

    torchrun --standalone --nproc-per-node 1 openvla_dataset.py vla-scripts/finetune.py --dataset_name ${name} ...
"""

import runpy
import sys

from prismatic.vla.datasets.rlds.oxe.configs import OXE_DATASET_CONFIGS, ActionEncoding, StateEncoding
from prismatic.vla.datasets.rlds.oxe.transforms import OXE_STANDARDIZATION_TRANSFORMS

${facts}

NAME = ${name}


def standardize(trajectory):
    """Return a trajectory as OpenVLA takes it, which it is: gripper 1 is open, rotations are roll-pitch-yaw."""
    return trajectory


OXE_DATASET_CONFIGS[NAME] = {
    "image_obs_keys": {"primary": ${image}, "secondary": None, "wrist": None},
    "depth_obs_keys": {"primary": None, "secondary": None, "wrist": None},
    # OpenVLA does not look at the state.
    "state_obs_keys": [None] * 8,
    "state_encoding": StateEncoding.NONE,
    "action_encoding": ActionEncoding.EEF_POS,
}
OXE_STANDARDIZATION_TRANSFORMS[NAME] = standardize

if __name__ == "__main__":
    del sys.argv[0]
    runpy.run_path(sys.argv[0], run_name="__main__")
'''
