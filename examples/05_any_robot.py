"""The same program on every robot: change one word.

A lab says what stands around a robot, ids which tasks are at home there; the scripted expert of the task does the rest.
"""

from __future__ import annotations

import rcs
from rcs.agents import agent_for
from rcs.rollout.episode import run_episode
from rcs.setups.ids import tasks_of

ROBOT = "fr3"  # or any other that `rcs list` names

setup = rcs.Setup(task=tasks_of(ROBOT)[0], robot=ROBOT)
env = rcs.make(setup)
print(env)
result = run_episode(env, agent_for(env), seed=0)
seconds = result.steps / setup.frequency
print(f"{setup.task} on {ROBOT}: {'success' if result.success else result.failure} after {seconds:.1f} s")
env.close()
