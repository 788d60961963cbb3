"""The contract of hands, as tests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Hand
from rcs.testing.motion_contract import MotionContract


class HandContract(MotionContract[Hand]):
    """Checks a hand. Moves every joint by `distance`, several times, with nothing between the fingers."""

    distance: float = 0.4
    """How far every joint moves, as a share of its range, towards its middle."""
    tolerance: float = 0.02
    """How close to its target a joint must come, and how far one at rest may move [1]."""

    def position(self, device: Hand) -> NDArray[np.float64]:
        """Return the joints, 0 to 1 of their ranges."""
        return np.clip(device.state().joints, 0.0, 1.0)

    def command(self, device: Hand, target: Any, valid_for: float = math.inf) -> None:
        """Send joints."""
        device.command_joints(target, valid_for)

    def target_of(self, device: Hand) -> NDArray[np.float64]:
        """Return a target that is `distance` away at every joint."""
        joints = self.position(device)
        return joints + np.where(joints < 0.5, self.distance, -self.distance)

    def bad_targets(self, device: Hand) -> list[NDArray[np.float64]]:
        """Return targets of a wrong size, not finite and out of range."""
        joints = self.position(device)
        bad = [np.array([value, *joints[1:]]) for value in (math.nan, math.inf, -math.inf, -0.01, 1.01)]
        return [joints[1:], np.append(joints, 0.0), *bad]

    def test_a_state_has_a_normalised_value_for_every_joint(self) -> None:
        """Measurements are copies."""
        with self.open_device() as hand:
            state = hand.state()
            assert state.joints.shape == (hand.joint_count,)
            assert ((state.joints >= -self.tolerance) & (state.joints <= 1 + self.tolerance)).all()
            state.joints[:] = 9.0
            assert (hand.state().joints < 9.0).all()
