"""A setup in which a policy can run: what it names of control, cameras and observations."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

from rcs.envs.setup import Setup
from rcs.envs.spaces import (
    FINGER_CONTACTS,
    IS_GRASPED,
    JOINT_TORQUES,
    PRIVILEGED,
    TARGET,
    TCP_WRENCH,
    TWIST,
    Control,
    Observed,
)
from rcs.policy.offer import key_of

if TYPE_CHECKING:
    from vlagents import Metadata

OBSERVE_TARGET = "ObserveTarget"
"""The layer that shows the last target."""

_OBSERVED: dict[str, Observed] = {
    JOINT_TORQUES: "torques", TCP_WRENCH: "wrench", FINGER_CONTACTS: "contacts", IS_GRASPED: "contacts",
}  # fmt: skip


def fitted(setup: Setup, metadata: Metadata, given: Collection[str] = ()) -> Setup:
    """Return a setup with the control, the cameras, the image size and the observations that a policy names.

    Args:
        setup: Everything else.
        metadata: Of the policy.
        given: Names among `control`, `relative`, `cameras` and `image_size` that are to stay as they are.
    """
    changes: dict[str, Any] = {}
    arm = next((part for part in metadata.action if key_of(part.name) in get_args(Control)), None)
    if arm is not None:
        changes["control"] = key_of(arm.name)
        is_absolute = arm.meaning != "delta" and changes["control"] != TWIST
        changes["relative"] = "absolute" if is_absolute else "last_step"
    cameras: dict[str, Any] = {}
    if metadata.action:
        cameras["names"] = tuple(image.name for image in metadata.images)
    sizes = {(image.width, image.height) for image in metadata.images if image.width and image.height}
    if len(sizes) == 1:
        cameras["image_size"] = sizes.pop()
    observed = [name for part in metadata.state if (name := _observed(part.name)) is not None]
    changes["observe"] = tuple(dict.fromkeys([*setup.observe, *observed]))
    if any(TARGET in part.name.split("/") for part in metadata.state) and OBSERVE_TARGET not in setup.layers:
        changes["layers"] = (*setup.layers, OBSERVE_TARGET)
    kept = {name: value for name, value in cameras.items() if {"names": "cameras"}.get(name, name) not in given}
    changes["cameras"] = replace(setup.cameras, **kept)
    return replace(setup, **{name: value for name, value in changes.items() if name not in given or name == "cameras"})


def _observed(name: str) -> Observed | None:
    return "privileged" if PRIVILEGED in name.split("/") else _OBSERVED.get(key_of(name))
