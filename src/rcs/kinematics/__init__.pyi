from rcs._core import DampedLeastSquares as DampedLeastSquares
from rcs._core import IkOptions as IkOptions
from rcs._core import IkResult as IkResult
from rcs._core import IkStatus as IkStatus
from rcs._core import Kinematics as Kinematics
from rcs.kinematics.chain import attach_end_effector as attach_end_effector
from rcs.kinematics.chain import kinematics_of as kinematics_of
from rcs.kinematics.chain import load as load
