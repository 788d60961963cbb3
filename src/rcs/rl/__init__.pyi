from rcs.rl.flat import Flat as Flat
from rcs.rl.layout import FlatLayout as FlatLayout
from rcs.rl.sb3 import Sb3VecEnv as Sb3VecEnv
from rcs.rl.selection import Selection as Selection
