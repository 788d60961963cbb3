"""The contract of grippers, as tests."""

from __future__ import annotations

import math
from typing import Any

import pytest

from rcs.devices import Gripper
from rcs.errors import InvalidAction
from rcs.testing.motion_contract import MotionContract


class GripperContract(MotionContract[Gripper]):
    """Checks a gripper. Opens and closes it fully, with nothing between the fingers."""

    tolerance: float = 0.02
    """How close to its target an opening must come, and how far one at rest may move [1]."""
    tick: float = 0.02
    """How often the gripper is looked at while it moves [s]."""

    def position(self, device: Gripper) -> float:
        """Return the opening, 0 to 1."""
        return min(max(device.state().opening, 0.0), 1.0)

    def command(self, device: Gripper, target: Any, valid_for: float = math.inf) -> None:
        """Send an opening."""
        device.command_opening(target, valid_for=valid_for)

    def target_of(self, device: Gripper) -> float:
        """Return the end of the range that is farther from the present opening."""
        return 0.0 if self.position(device) > 0.5 else 1.0

    def bad_targets(self, device: Gripper) -> list[float]:
        """Return openings that are not finite or out of range."""
        return [-0.01, 1.01, math.nan, math.inf, -math.inf]

    def test_a_state_is_an_opening_from_0_to_1_and_a_force_or_none(self) -> None:
        """The force is NaN where it is not measured; width and largest force are known before the gripper is opened."""
        gripper = self.make_device()
        assert 0 < gripper.max_width < math.inf
        assert 0 < gripper.max_force < math.inf
        with gripper:
            state = gripper.state()
            assert -self.tolerance <= state.opening <= 1 + self.tolerance
            assert not math.isinf(state.force)

    def test_fingers_open_and_close_with_any_force_up_to_the_largest(self) -> None:
        """Other forces are refused, and the fingers stay."""
        with self.open_device() as gripper:
            before, target = self.position(gripper), self.target_of(gripper)
            for force in (0.0, -1.0, 1.01 * gripper.max_force, math.nan, math.inf):
                with pytest.raises(InvalidAction, match="force"):
                    gripper.command_opening(target, force)
            self.advance(self.stopping_time)
            assert self.is_near(gripper, before)
            for opening, force in ((target, gripper.max_force), (1.0 - target, gripper.max_force / 2)):
                gripper.command_opening(opening, force)
                self.require_reached(gripper, opening)

    def test_fingers_go_all_the_way_and_half_of_it(self) -> None:
        """In any order."""
        with self.open_device() as gripper:
            for opening in (0.0, 1.0, 0.5, 1.0, 0.0, 0.5):
                self.command(gripper, opening)
                self.require_reached(gripper, opening)

    def test_a_refused_force_leaves_a_motion_as_it_is(self) -> None:
        """The fingers go on to the opening of the command before."""
        with self.moving_device() as (gripper, target):
            with pytest.raises(InvalidAction, match="force"):
                gripper.command_opening(1.0 - target, -1.0)
            self.require_reached(gripper, target)

    def test_an_opening_with_a_force_has_a_time_to_live_too(self) -> None:
        """Which must be more than nothing."""
        with self.staying_device() as gripper:
            target = self.target_of(gripper)
            for valid_for in (0.0, -1.0, math.nan):
                with pytest.raises(InvalidAction, match="valid for"):
                    gripper.command_opening(target, gripper.max_force, valid_for)
