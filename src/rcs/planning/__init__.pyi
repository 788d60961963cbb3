from rcs.planning.interpolation import PoseLine as PoseLine
from rcs.planning.interpolation import Quintic as Quintic
from rcs.planning.interpolation import minimum_jerk as minimum_jerk
