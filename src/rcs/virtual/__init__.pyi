from rcs.virtual.sim_driver import SimDriver as SimDriver
from rcs.virtual.stand_in_arm import StandInArm as StandInArm
