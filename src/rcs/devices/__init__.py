"""Devices behind one interface each, implementable in C++ or in Python, and how to find them by name."""

from rcs._core import (
    Arm,
    ArmLimits,
    ArmState,
    Camera,
    CameraCalibration,
    CameraMode,
    CommandKind,
    Device,
    Frame,
    Gripper,
    GripperState,
    Hand,
    HandState,
    stop_all,
)

__all__ = [
    "Arm",
    "ArmLimits",
    "ArmState",
    "Camera",
    "CameraCalibration",
    "CameraMode",
    "CommandKind",
    "Device",
    "Frame",
    "Gripper",
    "GripperState",
    "Hand",
    "HandState",
    "stop_all",
]
