"""The same program runs on every robot: change one word.

A lab defines the surroundings of a robot, ids its tasks; the task's scripted expert does the rest.
"""

from __future__ import annotations

import rcs
from rcs.agents import agent_for
from rcs.setups import tasks_of

ROBOT = "fr3"  # or any other that `rcs list` names

task = tasks_of(ROBOT)[0]
env = rcs.make(task, robot=ROBOT)
print(env)
result = rcs.run_episode(env, agent_for(env), seed=0)
seconds = result.steps / env.frequency
print(f"{task} on {ROBOT}: {'success' if result.success else result.failure} after {seconds:.1f} s")
env.close()
