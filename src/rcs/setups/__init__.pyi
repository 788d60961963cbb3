from rcs.setups.ids import ids as ids
from rcs.setups.ids import tasks_of as tasks_of
from rcs.setups.lab import CameraMount as CameraMount
from rcs.setups.lab import Lab as Lab
from rcs.setups.lab import Stand as Stand
from rcs.setups.lab import lab_of as lab_of
from rcs.setups.lab import looking as looking
