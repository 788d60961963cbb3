"""Layers: pure maps between the actions and observations of two levels of an environment."""

from rcs.envs.layers.binary_gripper import BinaryGripper
from rcs.envs.layers.cartesian import CartesianControl
from rcs.envs.layers.grasp_hand import GraspHand
from rcs.envs.layers.layer import Action, ActionSpaces, Layer, Where, everywhere
from rcs.envs.layers.limit_step import LimitStep
from rcs.envs.layers.relative import Relative
from rcs.envs.layers.wrapper import LayerWrapper
from rcs.envs.layers.wrist_camera import WristCamera
from rcs.envs.layers.xyzrpy import XyzrpyControl

__all__ = [
    "Action",
    "ActionSpaces",
    "BinaryGripper",
    "CartesianControl",
    "GraspHand",
    "Layer",
    "LayerWrapper",
    "LimitStep",
    "Relative",
    "Where",
    "WristCamera",
    "XyzrpyControl",
    "everywhere",
]
