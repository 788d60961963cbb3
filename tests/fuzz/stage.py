"""Targets that the fuzzer calls: all of the core, worlds and environments, with objects to call them on."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

import rcs
from rcs import _core
from rcs.devices.fakes import FakeArm, FakeCamera, FakeGripper, FakeHand
from rcs.errors import MissingDependency
from rcs.sim.world import Callback, World

from .hostile_values import array_of, cap, hostile, near
from .targets import Argument, Target

MODEL = """
<mujoco>
  <option timestep="0.002"/>
  <size nuserdata="60"/>
  <worldbody>
    <camera name="eye" pos="0 -2 1" xyaxes="1 0 0 0 0.4 0.9"/>
    <geom type="plane" size="1 1 0.1"/>
    <body name="base" pos="0 0 0.2">
      <body name="link1"><joint name="j1" axis="0 0 1" range="-2 2"/>
        <geom size="0.03" fromto="0 0 0 0.2 0 0" type="capsule"/>
        <body name="link2" pos="0.2 0 0"><joint name="j2" axis="0 1 0" range="-2 2"/>
          <geom size="0.03" fromto="0 0 0 0.2 0 0" type="capsule"/>
          <body name="link3" pos="0.2 0 0"><joint name="j3" axis="0 1 0" range="-2 2"/>
            <geom size="0.03" fromto="0 0 0 0.1 0 0" type="capsule"/><site name="tcp" pos="0.1 0 0"/>
          </body>
        </body>
      </body>
    </body>
    <body pos="0.3 0.3 0.05"><freejoint/><geom size="0.05"/></body>
  </worldbody>
  <actuator>
    <position joint="j1" kp="20" kv="2"/><position joint="j2" kp="20" kv="2"/><position joint="j3" kp="20" kv="2"/>
  </actuator>
</mujoco>"""


class Kept(_core.StepCallback):
    """A callback that keeps what it was given, and changes the world that calls it."""

    def __init__(self, stage: Stage) -> None:
        super().__init__()
        self.stage = stage

    def call(self, view: Any) -> Any:
        self.stage.keep(view)
        self.stage.look_at(view)[1]()
        if self.stage.r.random() < 0.02:
            self.stage.any_call()
        return self.stage.r.choice([True, False, False, None, "x"]) if self.stage.r.random() < 0.05 else False


class Shared:
    """Objects that are too slow to be made for each round: environments and what draws."""

    def __init__(self) -> None:
        self.envs: dict[str, Any] = {}
        self.drawing: list[Any] | None = None

    def env(self, kind: str) -> Any:
        if kind not in self.envs:
            make = rcs.make if kind == "one" else rcs.make_vec
            self.envs[kind] = make("Free", robot="fr3", **({} if kind == "one" else {"copies": 2}))
            self.envs[kind].reset(seed=1)
        return self.envs[kind]

    def renderers(self, model: mujoco.MjModel) -> list[Any]:
        if self.drawing is None:
            try:
                self.drawing = [_core.Renderer(model, max_width=64, max_height=48)]
                self.drawing.append(_core.RenderPool(model, 2, max_width=64, max_height=48))
            except MissingDependency:
                self.drawing = []
        return self.drawing


class Stage:
    """The objects of one round. The calls, their objects and their arguments follow from the seed alone."""

    model = mujoco.MjModel.from_xml_string(MODEL)
    other_model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )

    def __init__(self, seed: str, shared: Shared, targets: list[Target]) -> None:
        self.r = random.Random(seed)
        self.shared = shared
        self.targets = targets
        self.kept: list[Any] = []
        self.describe: Callable[[str], None] = lambda text: None
        limits = _core.ArmLimits([-2.0] * 3, [2.0] * 3, [1.0] * 3)
        motion_limits = _core.MotionLimits([-2.0] * 3, [2.0] * 3, [1.0] * 3, [10.0] * 3, [100.0] * 3)
        motion = _core.Motion([0, 1, 2], [0, 1, 2], 0, motion_limits, 3)
        body = _core.ArmBody(self.model, [0, 1, 2], 0, 1)
        flags = np.arange(self.model.ngeom) == self.model.ngeom - 1
        one = World(self.model, stepping="sync", max_substeps=40)
        many = World(self.model, copies=3, threads=2, frequency=60.0)
        state = many.core
        gripper = _core.GripperMap(0.0, 1.0, 0.0, 1.0)
        self.data, self.other_data = mujoco.MjData(self.model), mujoco.MjData(self.other_model)
        self.objects: list[Any] = [
            limits,
            gripper,
            one,
            many,
            one.core,
            state,
            _core.Pose(),
            _core.Pose.from_rpy([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]),
            _core.IkOptions(restarts=2),
            _core.CameraMode(4, 2, 30.0, True),
            _core.IkStatus.ok,
            _core.DampedLeastSquares(self.model, [0, 1, 2], 0, 1),
            FakeArm(limits),
            FakeGripper(),
            FakeHand(4),
            FakeCamera(_core.CameraMode(4, 2, 30.0, True)),
            _core.SimArm("arm", limits, state, 1, motion),
            _core.SimGripper("gripper", 0.1, 10.0, state, 2, [2], 2, gripper),
            _core.JointsArrived([0, 1], [0, 1], 1e-3, 1e-2),
            _core.JointsAtRest([0, 1], 1e-2, 0.01, 3),
            motion_limits,
            motion,
            body,
            _core.ArmLoads(body),
            _core.FingerContacts(self.model, [flags.astype(np.uint8)], (~flags).astype(np.uint8), 0.1),
            _core.CollisionReaction(body, [5.0] * 3, [20.0] * 6, True, 0.01, 0.01, 3),
            _core.Lens(cx=3.5, cy=3.5, width=8, height=8),
            Kept(self),
            Callback(lambda view: view.time > 1e9),
        ]
        self.lasting = len(self.objects)
        self.devices = [thing for thing in self.objects if isinstance(thing, _core.Device)]
        for device in self.devices:
            if self.r.random() < 0.8:
                device.open()

    def close(self) -> None:
        """Close all devices: an open one lives on, and its world with it."""
        for device in self.devices:
            device.close()

    def keep(self, value: Any) -> None:
        """Remember what a call returned, to use it later."""
        if value is None or isinstance(value, bool | int | float | str):
            return
        self.kept.append(value)
        if len(self.kept) > 30:
            del self.kept[self.r.randrange(len(self.kept))]
        if type(value).__module__ == "rcs._core" or isinstance(value, World):
            self.objects.append(value)
            if isinstance(value, _core.Device):
                self.devices.append(value)
            if len(self.objects) > 60:
                del self.objects[self.r.randrange(self.lasting, len(self.objects))]

    def instance(self, owner: type) -> Any:
        """Return an object of a class, mostly."""
        if owner.__name__ in ("Renderer", "RenderPool"):
            found = self.shared.renderers(self.model)
        else:
            found = self.objects
        matching = [o for o in found if isinstance(o, owner)]
        return self.r.choice(matching) if matching and self.r.random() < 0.99 else self.r.choice(self.objects)

    def good(self, target: str, argument: Argument) -> Any:
        """Return a value that the call takes, or one that it may take."""
        r, name, annotation = self.r, argument.name, argument.annotation
        match name:
            case "model":
                return self.model if r.random() < 0.95 else self.other_model
            case "data":
                # Of the model that goes with it, mostly; the other one is refused.
                return r.choice([self.data, self.data, self.other_data]) if target != "sim.World" else None
            case "site" | "frame_body" | "body" | "copy" | "actuator" | "tcp_site" | "base_body" | "camera_id" | "id":
                return "base" if target.startswith("sim.") else r.randrange(2)
            case "copies" if target in ("Motion", "CollisionReaction"):
                return 3
            case "address":
                return r.choice([0, 0, 26, 30, 34, 60])
            case "copies" if annotation == "int" or target == "sim.World":
                return 2
            case "copies":
                return np.unique(np.array([r.randrange(3) for _ in range(2)], np.int32))
            case "field":
                return r.choice(["body_mass", "geom_rgba", "geom_size", "opt", "body_pos", "actuator_gainprm", "qpos0"])
            case "names":
                return []
            case "which":
                return 1 << r.randrange(14)
            case "mode" if target == "sim.World":
                return r.choice(["async", "sync"])
            case "frequency":
                return r.choice([30.0, 60.0, 500.0])
            case "translation" | "rpy" | "rotvec":
                return np.array([r.uniform(-3, 3) for _ in range(3)])
            case "quaternion":
                q = np.array([r.gauss(0, 1) for _ in range(4)])
                return q / np.linalg.norm(q)
            case "matrix":
                return np.eye(4)
            case "twist" | "xyzrpy":
                return np.array([r.uniform(-1, 1) for _ in range(6)])
            case "tquat" | "a" | "b" | "goal":
                return np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0])
            case "targets":
                return np.tile([0.2, 0.1, 0.3, 0.0, 0.0, 0.0, 1.0], (2, 1))
            case "starts":
                return np.zeros((2, 3))
            case "start":
                return np.zeros(3) if "inverse" in target else np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0])
            case "joints" if target.startswith("Hand"):
                return np.full(4, r.random())
            case "joints" if "forward_batch" in target:
                return np.zeros((2, 3))
            case "joints" if "Sequence[int]" in annotation or "list[int]" in annotation:
                return [0, 1, 2]
            case "wrench" if target == "CollisionReaction":
                return [r.uniform(1, 50) for _ in range(6)]
            case "joint_lower" | "lower" if "Sequence[float]" in annotation:
                return [-1.0, -1.0, -1.0]
            case _ if "Sequence[float]" in annotation:
                return [r.uniform(0.1, 10) for _ in range(3)]
            case "joints" | "lower" | "upper" | "max_step" | "values" | "asked" | "last" | "measured":
                return np.array([r.uniform(0, 1) for _ in range(3)])
            case "actuators":
                return [0, 1, 2]
            case "first" | "second" | "own":
                return np.ones(self.model.ngeom, np.uint8)
            case "fingers":
                return [np.eye(self.model.ngeom, dtype=np.uint8)[r.randrange(self.model.ngeom)] for _ in range(2)]
            case "lookup":
                return np.array([r.uniform(-1, 9) for _ in range(8 * 8 * 2)], np.float32).reshape(8, 8, 2)
            case "cx" | "cy":
                return 3.5
            case "width" | "height":
                return 8
            case "table":
                return np.arange(256, dtype=np.uint8).view(np.int8)
            case "normal":
                return np.linspace(-2, 2, 16, dtype=np.float32)
            case "state":
                return np.zeros(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
            case "states":
                return np.zeros((2, mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION)))
            case "camera_ids":
                return [0]
            case "depth" if target == "measure_stereo":
                return np.array([r.randrange(3000) for _ in range(4 * 6)], np.uint16).reshape(4, 6)
            case "rgb" if target == "measure_stereo":
                return np.zeros((4, 6, 3), np.uint8)
            case "rgb" if "Pool" in target:
                return [np.zeros((2, 8, 8, 3), np.uint8)]
            case "depth" | "world" if target.startswith("Render"):
                return None
            case "wxyz" | "xyzw":
                return np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
            case "opening":
                return r.random()
            case "timing":
                return "fast"
            case "backend":
                return "auto"
            case _:
                pass
        kind = getattr(_core, annotation.split("|")[0].strip().rsplit(".", 1)[-1], None)
        if isinstance(kind, type):
            return self.instance(kind)
        if "ndarray" in annotation or "NDArray" in annotation or "ArrayLike" in annotation:
            return array_of(r, annotation)
        simple = {"int": r.randrange(3), "float": r.random(), "bool": True, "str": "name"}
        return simple.get(annotation, hostile(r))

    def value(self, target: str, argument: Argument) -> Any:
        """Return an argument, mostly a good one."""
        chance = self.r.random()
        if argument.name == "frequency" and chance > 0.8:
            return self.r.choice([0.0, -1.0, np.nan, np.inf, 1e9, 0.7, None, "30"])
        if chance < 0.75:
            return self.good(target, argument)
        if chance < 0.9:
            return cap(argument.name, near(self.r, self.good(target, argument)))
        value = self.r.choice(self.objects + self.kept) if self.r.random() < 0.2 else hostile(self.r)
        return cap(argument.name, value)

    def core_call(self, target: Target) -> tuple[str, Callable[[], Any]]:
        """Return a call of the core or of a world, and its text."""
        arguments = self.r.choice(target.overloads) if target.overloads else ()
        values = {a.name: self.value(target.name, a) for a in arguments}
        if values and self.r.random() < 0.1:
            values.pop(self.r.choice(list(values)))
        first = () if target.owner is None else (self.instance(target.owner),)
        text = f"{target.name}({', '.join(f'{k}={_short(v)}' for k, v in values.items())})"
        return text, lambda: target.function(*first, **values)

    def env_call(self) -> tuple[str, Callable[[], Any]]:
        """Return a call of an environment."""
        kind = self.r.choice(["one", "many"])
        env = self.shared.env(kind)
        action = env.action_space.sample()
        chance = self.r.random()
        if chance < 0.6:
            key = self.r.choice(list(action))
            if self.r.random() < 0.7:
                action[key] = near(self.r, action[key]) if self.r.random() < 0.6 else hostile(self.r)
            elif self.r.random() < 0.5:
                action = self.r.choice([hostile(self.r), {}, {**action, "x": 1}])
            return f"{kind} env.step({_short(action)})", lambda: env.step(action)
        seed = self.r.choice([None, 1, hostile(self.r)])
        options = self.r.choice([None, None, {}, {"robot": hostile(self.r)}, hostile(self.r)])
        if chance < 0.97:
            return (
                f"{kind} env.reset(seed={_short(seed)}, options={_short(options)})",
                lambda: env.reset(seed=seed, options=options),
            )
        if self.r.random() < 0.5:
            self.shared.envs.pop(kind)
        return f"{kind} env.close()", env.close

    def write(self) -> tuple[str, Callable[[], Any]]:
        """Return a write to an array that a call returned, or to the state of a world."""
        arrays = [a for a in self.kept if isinstance(a, np.ndarray)]
        arrays += [w.qpos for w in self.objects if isinstance(w, World)]
        array = self.r.choice(arrays)
        value = hostile(self.r)
        return f"array{array.shape}[...] = {_short(value)}", lambda: array.__setitem__(..., value)

    def look(self) -> tuple[str, Callable[[], Any]]:
        """Return a look at everything that an object has."""
        return self.look_at(self.r.choice(self.kept or self.objects))

    def look_at(self, thing: Any) -> tuple[str, Callable[[], Any]]:
        """Return a look at something that a thing has."""
        names = [n for n in dir(type(thing)) if not n.startswith("_") and not callable(getattr(type(thing), n))]
        name = self.r.choice(names or ["__class__"])
        return f"{type(thing).__name__}.{name}", lambda: repr(getattr(thing, name))

    def next_call(self, can_be_env: bool = True) -> tuple[str, Callable[[], Any]]:
        """Return what is called next."""
        chance = self.r.random()
        if chance < 0.004 and can_be_env:
            return self.env_call()
        if chance < 0.05:
            return self.write()
        if chance < 0.1:
            return self.look()
        while True:
            target = self.r.choice(self.targets)
            # What draws, and what starts threads, is slow; the share of calls is small, not that of time.
            is_slow = target.name.startswith(("Render", "probe_gl")) or target.name in ("World.of_copies", "sim.World")
            if not is_slow or self.r.random() < (
                0.002 if target.name in ("Renderer", "RenderPool", "probe_gl") else 0.3
            ):
                return self.core_call(target)

    def any_call(self) -> None:
        """Make a call from inside of another."""
        text, call = self.next_call(can_be_env=False)
        self.describe(f"in a callback: {text}")
        call()


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        text = f"array({value.tolist()}, {value.dtype})" if value.size <= 8 else f"array{value.shape} {value.dtype}"
    else:
        try:
            text = repr(value)
        except Exception as error:  # noqa: BLE001  the text of a hostile value may fail in any way
            text = f"<{type(error).__name__}>"
    return text if len(text) <= 80 else f"{text[:77]}..."
