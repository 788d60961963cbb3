"""Actions of a tool that keeps its tilt: fewer numbers to learn where a tool points down."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from rcs.envs.layers.layer import ActionSpaces, Layer
from rcs.envs.spaces import XYZRPY, XYZYAW, Action
from rcs.errors import InvalidSetup

_KEPT = [0, 1, 2, 5]
"""Of translation and roll, pitch, yaw: what is left."""


class KeepTilt(Layer):
    """Take `xyzyaw`, the differences of translation and yaw, and pass on `xyzrpy` without roll and pitch.

    Put it on relative `xyzrpy` control. The tool keeps the tilt that it has: an arm with six joints or more that of its
    home pose, one with five leans as it must.
    """

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `xyzrpy` by `xyzyaw`.

        Raises:
            InvalidSetup: The level below takes no `xyzrpy`.
        """
        if XYZRPY not in inner:
            raise InvalidSetup(
                f"KeepTilt is on top of {', '.join(inner) or 'no actions'}; it needs control='xyzrpy' and "
                "relative='last_step'."
            )
        box = inner[XYZRPY]
        own = spaces.Box(box.low[_KEPT], box.high[_KEPT], dtype=np.float64)
        return {(XYZYAW if key == XYZRPY else key): (own if key == XYZRPY else space) for key, space in inner.items()}

    def map_action(self, action: Action) -> Action:
        """Put in a roll and a pitch of 0."""
        given = action[XYZYAW]
        full = np.zeros((*given.shape[:-1], 6))
        full[..., _KEPT] = given
        return {(XYZRPY if key == XYZYAW else key): (full if key == XYZYAW else own) for key, own in action.items()}
