"""The cameras of a scene, drawn together: each call updates the rendered scene once, then draws every camera."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import Renderer, RenderPool
from rcs.errors import InvalidSetup
from rcs.sim.noise import CameraNoise
from rcs.sim.optics import Optics
from rcs.sim.scene import CameraPlacement
from rcs.sim.world import Copies, World
from rcs.spatial import tquat_to_matrix

Quality = Literal["fast", "full"]
"""`fast`: no shadows, reflections or antialiasing. `full`: all of these."""

MAX_SIZE = 4096
"""Largest edge of a frame [px]."""

BACKGROUND = "background"
"""Name of the number 0."""

FrameArrays = dict[str, NDArray[Any]]
"""The output of a camera: `rgb`, `depth`, `segmentation` and `geoms` where they are wanted, `intrinsics`, `distortion`,
`extrinsics`. The arrays are read-only."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """A moment of the simulation, from which frames can be drawn later."""

    state: NDArray[np.float64]
    """The simulation's integration state, (state_size,)."""
    time: float
    """When the simulation was in this state [s], on the monotonic clock."""
    calibrations: Mapping[str, FrameArrays]
    """`intrinsics`, `distortion` and `extrinsics` of each camera to be drawn."""
    moment: NDArray[np.float64]
    """Time and positions of all joints, (1 + nq,), which determine the noise."""


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Arrays that the renderer fills for one camera."""

    rgb: NDArray[np.uint8]
    depth: NDArray[np.uint16] | None
    geoms: NDArray[np.uint16] | None

    def __getitem__(self, rows: Any) -> _Drawn:
        depth, geoms = (None if values is None else values[rows] for values in (self.depth, self.geoms))
        return _Drawn(self.rgb[rows], depth, geoms)


class SimCameras:
    """All cameras of a world's scene. The renderer is created by the first `read`, and draws in its own GL context.

    A read shows the present state; `CameraFeed` adds the frame rates of devices.
    """

    def __init__(
        self,
        world: World,
        cameras: list[CameraPlacement],
        *,
        size: tuple[int, int] | Mapping[str, tuple[int, int]] = (224, 224),
        has_depth: bool = False,
        has_segmentation: bool = False,
        quality: Quality = "fast",
        frame_body: int = 0,
        has_noise: bool = False,
    ) -> None:
        """Look the cameras up.

        Args:
            world: The world to draw.
            cameras: Cameras of its scene.
            size: Width and height of every frame [px], or those of each camera by name.
            has_depth: Draw depth, too.
            has_segmentation: Draw instances and geoms, too.
            quality: Rendering quality.
            has_noise: Add the noise of real cameras.
            frame_body: Body that is the reference frame of extrinsics: the robot's base, or 0 for the scene.

        Raises:
            InvalidSetup: The size is out of range, a camera has no depth, or its distortion cannot be drawn.
        """
        self.sizes = {camera.name: size[camera.name] if isinstance(size, Mapping) else size for camera in cameras}
        """Width and height of each camera's frames [px]."""
        for own in self.sizes.values():
            if not all(1 <= edge <= MAX_SIZE for edge in own):
                raise InvalidSetup(f"The size of a frame is {own}; valid is 1 to {MAX_SIZE} px for width and height.")
        for camera in cameras:
            if has_depth and not camera.camera.has_depth:
                raise InvalidSetup(f"Camera {camera.name!r} ({camera.camera.label}) has no depth.")
        self.world = world
        self.placements = list(cameras)
        self.names = [camera.name for camera in cameras]
        self.has_depth = has_depth
        self.has_segmentation = has_segmentation
        self.labels = Labels(world.model)
        """Names of the numbers in segmentation."""
        self._quality: Quality = quality
        self._optics = [Optics(camera, self.sizes[camera.name], world.model) for camera in cameras]
        # A camera's body has the optical frame: x right, y down, z forward.
        bodies = [f"{camera.name}/{camera.camera.base_body}" for camera in cameras]
        self._poses = [world.core.read_body_pose(world.model.body(body).id, frame_body) for body in bodies]
        world.refresh()
        self._noise = [
            CameraNoise(camera.camera, self.sizes[camera.name], camera.name) for camera in cameras if has_noise
        ]
        self._renderer: Renderer | RenderPool | None = None
        self.capture_times: dict[str, float] = {}
        """When each camera's last frame was drawn [s], on the monotonic clock."""

    def read(self, names: Sequence[str] | None = None, copies: Copies = None) -> dict[str, FrameArrays]:
        """Draw cameras, each frame in new arrays that are read-only.

        Args:
            names: Cameras to draw; None for all.
            copies: Copies to draw; None for all. `leading` is then their number.

        Returns:
            Per camera `rgb` (*leading, H, W, 3) uint8; with depth, `depth` (*leading, H, W) uint16 [mm], 0 = no
            reading; with segmentation, `segmentation` and `geoms` (*leading, H, W) uint16, numbers of instances and
            geoms as in `labels`; `intrinsics` (*leading, 3, 3) [px]; `distortion` (*leading, 5), k1, k2, p1, p2, k3;
            `extrinsics` (*leading, 4, 4), its pose in OpenCV axes.
        """
        chosen = [self.names.index(name) for name in (self.names if names is None else names)]
        rows = slice(None) if copies is None else copies
        moment = self._moment()[rows]
        return {
            self.names[i]: self._frame(i, drawn, self._calibration(i, rows), moment)
            for i, drawn in zip(chosen, self._draw(chosen, copies), strict=True)
        }

    def snapshot(self, names: Sequence[str]) -> Snapshot:
        """Return a snapshot of the present moment, for a world of one copy.

        Args:
            names: Cameras to draw.
        """
        return Snapshot(
            state=self.world.states(),
            time=time.perf_counter(),
            calibrations={name: self._calibration(self.names.index(name), slice(None)) for name in names},
            moment=self._moment(),
        )

    def draw(self, snapshot: Snapshot, names: Sequence[str]) -> Iterator[tuple[str, FrameArrays]]:
        """Draw the frames of a snapshot's moment, one camera after the other, as `read` would have.

        May be called by another thread than the one that steps the world, but only by one at a time, and not during
        `read`.

        Args:
            snapshot: A snapshot that these cameras took.
            names: Cameras of the snapshot to draw.
        """
        renderer = self._renderer or self._make_renderer()
        assert isinstance(renderer, Renderer), "a world of one copy"
        renderer.update_from_state(snapshot.state)
        for name in names:
            i = self.names.index(name)
            yield name, self._frame(i, self._render(renderer, i), snapshot.calibrations[name], snapshot.moment)

    def _moment(self) -> NDArray[np.float64]:
        """Return time and positions of every copy, which determine the noise, (*leading, 1 + nq)."""
        time = np.broadcast_to(np.asarray(self.world.time, np.float64), self.world.leading)
        return np.concatenate([time[..., None], self.world.qpos], axis=-1)

    def _frame(self, i: int, drawn: _Drawn, calibration: FrameArrays, moment: NDArray[np.float64]) -> FrameArrays:
        """Return the whole frame of a camera, with noise if enabled."""
        frame: FrameArrays = {"rgb": drawn.rgb, **calibration}
        if drawn.depth is not None:
            frame["depth"] = drawn.depth
        if self._noise:
            frame = self._noise[i].add(frame, moment)
        if drawn.geoms is not None:  # what noise does not touch
            frame |= {"segmentation": self.labels.instances_of(drawn.geoms), "geoms": drawn.geoms}
        for values in frame.values():
            values.flags.writeable = False
        return frame

    def _draw(self, chosen: Sequence[int], copies: Copies) -> list[_Drawn]:
        """Draw some cameras."""
        renderer = self._renderer or self._make_renderer()
        if isinstance(renderer, Renderer):
            data = self.world.data
            assert data is not None
            mujoco.mj_camlight(self.world.model, data)
            renderer.update(data)
            return [self._render(renderer, i) for i in chosen]
        core = self.world.core
        # If copies have their own models, a row of states is a copy, and all have to be drawn.
        picks = copies is not None and not core.is_varied
        states = core.states[copies] if picks else core.states
        drawn = [self._empty(i, len(states)) for i in chosen]
        rgb, depth, geoms = ([getattr(one, part) for one in drawn] for part in ("rgb", "depth", "geoms"))
        ids, lenses = [self._optics[i].id for i in chosen], [self._optics[i].lens for i in chosen]
        renderer.render_states(states, ids, rgb, depth, None if picks else core, geoms, lenses)
        self.capture_times.update(dict.fromkeys([self.names[i] for i in chosen], time.perf_counter()))
        return drawn if copies is None or picks else [one[copies] for one in drawn]

    def _render(self, renderer: Renderer, i: int) -> _Drawn:
        """Draw a camera of what a renderer was given last."""
        drawn = self._empty(i)
        renderer.render(self._optics[i].id, drawn.rgb, drawn.depth, drawn.geoms, self._optics[i].lens)
        self.capture_times[self.names[i]] = time.perf_counter()
        return drawn

    def _empty(self, i: int, *leading: int) -> _Drawn:
        """Return arrays for a camera to be drawn into."""
        shape = (*leading, *self.sizes[self.names[i]][::-1])
        depth, geoms = (
            np.empty(shape, np.uint16) if wanted else None for wanted in (self.has_depth, self.has_segmentation)
        )
        return _Drawn(np.empty((*shape, 3), np.uint8), depth, geoms)

    def _calibration(self, i: int, rows: slice | NDArray[np.integer[Any]]) -> FrameArrays:
        """Return the present matrices of a camera, which may move and vary its field of view."""
        optics = self._optics[i]
        fovy = self.world.field("cam_fovy")[..., optics.id]
        poses = self.world.poses[..., self._poses[i], :]
        if self.world.leading:
            fovy, poses = fovy[rows], poses[rows]
        return {
            "intrinsics": optics.intrinsics(fovy),
            "distortion": optics.distortion(fovy),
            "extrinsics": tquat_to_matrix(poses),
        }

    def _make_renderer(self) -> Renderer | RenderPool:
        sizes = [*self.sizes.values(), *(optics.canvas for optics in self._optics)]
        width, height = (max(size[axis] for size in sizes) for axis in (0, 1))
        if self.world.leading:
            threads = min(self.world.core.threads, RenderPool.MOST_THREADS)
            self._renderer = RenderPool(
                self.world.model,
                threads=threads,
                quality=self._quality,
                max_width=width,
                max_height=height,
                is_rasterised=True,
            )
        else:
            self._renderer = Renderer(
                self.world.model, quality=self._quality, max_width=width, max_height=height, is_rasterised=True
            )
        return self._renderer

    def close(self) -> None:
        """Free the renderer. Closing twice is harmless; reading again makes a new one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class Labels:
    """Names of the instances and geoms that pictures of a model show.

    In `frames`/camera/`geoms`, 0 is the background and n the geom n - 1 of MuJoCo's model; soft bodies, skins and
    tendons are counted on after the geoms. In `frames`/camera/`segmentation`, geoms are joined to instances: an arm
    (`fr3`), its end effector (`fr3/gripper`), an object (`cuboid`), a camera's housing (`side`), the table, a wall.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Name everything that a model draws."""
        self.instances: list[str] = [BACKGROUND]
        """Name of each instance, by its number."""
        self.geoms: list[str] = [BACKGROUND]
        """Name of each geom, by its number: its own or that of its body."""
        self._instance_of: list[int] = [0]
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            own, of_body = model.geom(geom).name, model.body(body).name
            self._add(own or of_body, _instance(model, body) or own)
        for kind, count in (("FLEX", model.nflex), ("SKIN", model.nskin), ("TENDON", model.ntendon)):
            for i in range(count):
                found: str | None = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), i)
                name = found or f"{kind.lower()} {i}"
                body = _body_of_flex(model, i) if kind == "FLEX" else 0
                self._add(name, _instance(model, body) or name.rpartition("/")[0] or name)
        self._table = np.array(self._instance_of, np.uint16)

    def _add(self, geom: str, instance: str) -> None:
        instance = instance or "scene"
        if instance not in self.instances:
            self.instances.append(instance)
        self.geoms.append(geom)
        self._instance_of.append(self.instances.index(instance))

    def instances_of(self, geoms: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return the instance of every pixel.

        Args:
            geoms: The geom of every pixel, of any shape.
        """
        return self._table[geoms]

    def to_json(self) -> dict[str, Any]:
        """Return `instances` and `geoms`, lists of names by number, and `instance_of_geom`."""
        return {"instances": self.instances, "geoms": self.geoms, "instance_of_geom": self._instance_of}


def _instance(model: mujoco.MjModel, body: int) -> str:
    """Return the instance of a body: its prefix, or its ancestor below the world; empty for the world."""
    while body:
        name = str(model.body(body).name)
        if "/" in name:
            return name.rpartition("/")[0]
        parent = int(model.body_parentid[body])
        if parent == 0:
            return name or f"body {body}"
        body = parent
    return ""


def _body_of_flex(model: mujoco.MjModel, flex: int) -> int:
    """Return a body that carries a soft body; 0 if it is fixed to the world."""
    first, count = int(model.flex_vertadr[flex]), int(model.flex_vertnum[flex])
    bodies = model.flex_vertbodyid[first : first + count]
    if (bodies < 0).all():  # corners between the nodes of a coarser mesh
        first, count = int(model.flex_nodeadr[flex]), int(model.flex_nodenum[flex])
        bodies = model.flex_nodebodyid[first : first + count]
    found = bodies[bodies > 0]
    return int(found[0]) if len(found) else 0
