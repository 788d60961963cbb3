"""What a policy is shown: an environment's observation as named pictures and parts, in the policy's units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.spaces import FRAMES, PRIVILEGED, RGB, TQUAT, XYZRPY, Observation
from rcs.policy.holding import flat
from rcs.policy.offer import key_of, unit_of
from rcs.policy.packages import vlagents
from rcs.policy.part import Array
from rcs.policy.units import from_unit
from rcs.spatial import tquat_to_xyzrpy

if TYPE_CHECKING:
    import vlagents as v


def shown(
    observation: Observation,
    info: Mapping[str, Any],
    needs: v.Metadata,
    *,
    time: float,
    instruction: str,
    session: str,
) -> v.Observation:
    """Return an observation as a policy sees it: what its metadata name, or all that a robot has where they name none.

    Args:
        observation: Of the environment.
        info: Of the same step; its `ages` say when each sensor measured.
        needs: Of the policy.
        time: Of the observation [s].
        instruction: What is to be done.
        session: Whose observation it is.
    """
    values = flat({key: value for key, value in observation.items() if key != FRAMES})
    frames = observation.get(FRAMES, {})
    if needs.images or needs.state:
        cameras = [image.name for image in needs.images]
        state = {part.name: _in_unit(part.unit, part.name, _value(values, part.name)) for part in needs.state}
    else:
        cameras = [name for name in frames if RGB in frames[name]]
        state = {name: np.asarray(own, np.float64) for name, own in values.items() if PRIVILEGED not in name.split("/")}
    seen: v.Observation = vlagents().Observation(
        images={name: frames[name][RGB] for name in cameras},
        state=state,
        instruction=instruction,
        time=time,
        session=session,
    )
    return seen


def _value(values: Mapping[str, Any], name: str) -> NDArray[np.float64]:
    if name not in values and key_of(name) == XYZRPY:
        return tquat_to_xyzrpy(values[name[: -len(XYZRPY)] + TQUAT])
    return values[name]


def _in_unit(unit: str, name: str, value: Array) -> Array:
    """Return numbers of ours in a policy's unit."""
    scale, offset = from_unit(unit, unit_of(name)) or (1.0, 0.0)
    return (np.asarray(value, np.float64) - offset) / scale
