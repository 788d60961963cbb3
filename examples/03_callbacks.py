"""Step your own MuJoCo model and data in a world until your Python functions end the step.

A world is the physics below an environment and can be used alone. A synchronous step ends when every convergence
callback or any interrupt is true, or at a limit; a periodic callback runs at a rate of simulated time. The world works
on the given `MjData`: you can read its state there, and write to it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from rcs.sim import StepView, World

MODEL = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="wall" type="box" size="0.02 0.2 0.2" pos="0.35 0 0"/>
    <body name="slider">
      <joint name="slide" type="slide" axis="1 0 0" damping="4"/>
      <geom name="block" type="box" size="0.05 0.05 0.05" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="slide" kp="60" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""

model = mujoco.MjModel.from_xml_string(MODEL)
data = mujoco.MjData(model)
world = World(model, data=data, stepping="sync", max_substeps=2000)
trace: list[float] = []


def is_there(view: StepView) -> bool:
    """Return whether the block stands at its target."""
    return bool(abs(view.qpos[0] - view.ctrl[0]) < 1e-3 and abs(view.qvel[0]) < 1e-3)


def is_touching(view: StepView) -> bool:
    """Return whether anything touches anything."""
    return view.contacts > 0


def record(view: StepView) -> None:
    """Note where the block is."""
    trace.append(float(view.qpos[0]))


world.converge_when(is_there)
world.interrupt_when(is_touching)
world.on_period(record, 0.05)

for target in (0.1, -0.2, 0.5):
    data.ctrl[0] = target
    trace.clear()
    world.advance()
    end, substeps = world.ends[0].name, world.substeps[0]
    print(f"to {target:+.1f} m: {end} at {data.qpos[0]:+.3f} m after {substeps} physics steps")
    print("   every 0.05 s:", np.round(trace[:12], 2), "..." if len(trace) > 12 else "")
