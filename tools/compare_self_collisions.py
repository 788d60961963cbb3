"""Compare the arms' collision shapes with meshes of the real links: detected, missed and false self collisions.

    python tools/compare_self_collisions.py FOLDER [ARM ...]

FOLDER is a checkout of mujoco_menagerie, or a part of it with the models that the descriptions name. The meshes are its
visual ones, as they are: their triangles are intersected (by python-fcl, which is not among the dependencies), and no
hull takes their place. They ride on our own bodies, so that nothing but the shapes differs. Poses are uniform within
the limits of the joints, the gripper's included where the meshes have one. Pairs that a joint connects are left out on
both sides. Printed are a table and, as the last line, the same as JSON.

A pose is found if meshes and shapes touch, wherever; `pairs` counts each pair of links. False alarms are a share of the
poses in which no meshes touch. The gap is the widest between the shapes of links whose meshes touch in a missed pose,
and the part outside is how far a link's mesh reaches out of the link's own shapes.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import fcl
import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.kinematics.chain import GRIPPER_PREFIX, attach_end_effector, load
from rcs.robots import FR3, SO101, SO101_GRIPPER, UR5E, XARM7
from rcs.robots.description import ArmDescription, GripperDescription, MenagerieVisuals

ROBOTS: Final[dict[str, tuple[ArmDescription, GripperDescription | None]]] = {
    "fr3": (FR3, None),
    "ur5e": (UR5E, None),
    "xarm7": (XARM7, None),
    "so101": (SO101, SO101_GRIPPER),
}
Array = NDArray[np.float64]
Pair = tuple[str, str]
LAST_DRAWN_GROUP = 2
"""MuJoCo draws the groups 0 to 2 by default; the collection's models have their visuals there."""
FAR = 0.1
"""Distance up to which the gap between two links' shapes is measured [m]."""
SPACING = 0.004
"""Distance between the points on a mesh that are tested for coverage by a shape [m]."""


@dataclass
class Meshes:
    """The triangles of each link, in the link's frame."""

    triangles: dict[str, Array]
    """Corners by body, (n, 3, 3) [m]."""

    @staticmethod
    def read(folder: Path, parts: list[tuple[str, MenagerieVisuals | None]]) -> Meshes:
        """Read the meshes of a robot's parts; each has the prefix of its bodies' names."""
        triangles: dict[str, list[Array]] = {}
        for prefix, visuals in parts:
            if visuals is None:
                continue
            path = folder / visuals.model / f"{visuals.entry}.xml"
            if not path.is_file():
                sys.exit(f"{path} is missing; FOLDER must be a checkout of mujoco_menagerie.")
            model = mujoco.MjModel.from_xml_path(str(path))
            for body in visuals.bodies:
                mount = body.source_in_body.pose.matrix
                for geom in np.flatnonzero(model.geom_bodyid == model.body(body.source).id):
                    if (
                        model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
                        and model.geom_group[geom] <= LAST_DRAWN_GROUP
                    ):
                        corners = _corners(model, int(geom)) @ mount[:3, :3].T + mount[:3, 3]
                        triangles.setdefault(prefix + body.body, []).append(corners)
        return Meshes({body: np.concatenate(parts) for body, parts in triangles.items()})

    def surfaces(self) -> dict[str, fcl.CollisionObject]:
        """Return a tree of triangles by body."""
        objects = {}
        for body, triangles in self.triangles.items():
            tree = fcl.BVHModel()
            tree.beginModel(len(triangles), 3 * len(triangles))
            tree.addSubModel(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
            tree.endModel()
            objects[body] = fcl.CollisionObject(tree, fcl.Transform())
        return objects

    def points(self, body: str) -> Array:
        """Return points all over a body's surface, (n, 3) [m]."""
        triangles = self.triangles[body]
        edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1).max(axis=1)
        parts = np.ceil(edges / SPACING)
        points = [triangles.reshape(-1, 3)]
        for count in range(2, int(parts.max()) + 1):
            large = triangles[parts == count]
            shares = [(i, j, count - i - j) for i in range(count + 1) for j in range(count + 1 - i)]
            points.append(np.einsum("sc,ncx->nsx", np.array(shares) / count, large).reshape(-1, 3))
        # One point per cell is enough.
        everywhere = np.concatenate(points)
        _, first = np.unique(np.round(everywhere / SPACING).astype(int), axis=0, return_index=True)
        return everywhere[first]


def _corners(model: mujoco.MjModel, geom: int) -> Array:
    """Return the triangles of a mesh geom in its body's frame, (n, 3, 3) [m]."""
    mesh = int(model.geom_dataid[geom])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    vertices = model.mesh_vert[first : first + count] @ turn.reshape(3, 3).T + model.geom_pos[geom]
    return vertices[model.mesh_face[face : face + faces]]


class Robot:
    """A robot with its own shapes and the meshes beside them."""

    def __init__(self, folder: Path, arm: ArmDescription, gripper: GripperDescription | None) -> None:
        """Compile the model and read the meshes."""
        spec = load(arm)
        parts = [("", arm.menagerie)]
        if gripper is not None:
            attach_end_effector(spec, arm, gripper)
            parts.append((GRIPPER_PREFIX, gripper.menagerie))
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.meshes = Meshes.read(folder, parts)
        self._surfaces = self.meshes.surfaces()
        self.bodies = list(self._surfaces)
        self.pairs = [pair for pair in combinations(self.bodies, 2) if not self._are_joined(*pair)]
        self.shapes = {body: self._shapes_of(body) for body in self.bodies}

    def _are_joined(self, first: str, second: str) -> bool:
        """Return True if two bodies are one rigid part, or a joint connects them."""
        model = self.model
        one, other = (int(model.body_weldid[model.body(name).id]) for name in (first, second))
        parents = [int(model.body_weldid[model.body_parentid[weld]]) for weld in (one, other)]
        return one == other or one == parents[1] or other == parents[0]

    def _shapes_of(self, body: str) -> list[int]:
        """Return the geoms that collide of a body and of what is welded to it."""
        weld = self.model.body_weldid[self.model.body(body).id]
        ours = self.model.body_weldid[self.model.geom_bodyid] == weld
        if weld == 0:
            ours &= self.model.geom_bodyid == self.model.body(body).id
        return [int(geom) for geom in np.flatnonzero(ours & (self.model.geom_contype > 0))]

    def put(self, joints: Array) -> None:
        """Put the robot into a pose."""
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self.model, self.data)
        for body, surface in self._surfaces.items():
            place = self.data.body(body)
            surface.setTransform(fcl.Transform(place.xmat.reshape(3, 3), place.xpos))

    def meshes_that_touch(self) -> set[Pair]:
        """Return the pairs of links whose meshes intersect."""
        request, touching = fcl.CollisionRequest(), set[Pair]()
        for pair in self.pairs:
            if fcl.collide(*(self._surfaces[body] for body in pair), request, fcl.CollisionResult()):
                touching.add(pair)
        return touching

    def shapes_that_touch(self) -> set[Pair]:
        """Return the pairs of links whose shapes MuJoCo finds in contact."""
        mujoco.mj_collision(self.model, self.data)
        owner = {geom: body for body, geoms in self.shapes.items() for geom in geoms}
        found = {frozenset(owner.get(int(geom), "?") for geom in pair) for pair in self.data.contact.geom}
        return {pair for pair in self.pairs if frozenset(pair) in found}

    def gap(self, pair: Pair) -> float:
        """Return the distance between the shapes of two links [m]."""
        return min(
            mujoco.mj_geomDistance(self.model, self.data, one, other, FAR, None)
            for one in self.shapes[pair[0]]
            for other in self.shapes[pair[1]]
        )

    def outside(self, body: str) -> Array:
        """Return the distances of the mesh's points from the shapes of its link, 0 within [m]."""
        points = self.meshes.points(body)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        place = self.data.body(body)
        world = points @ place.xmat.reshape(3, 3).T + place.xpos
        return np.maximum(np.min([self._distance(geom, world) for geom in self.shapes[body]], axis=0), 0.0)

    def _distance(self, geom: int, points: Array) -> Array:
        """Return the signed distances of points from a sphere, capsule, cylinder or box [m]."""
        place, size = self.data.geom(geom), self.model.geom_size[geom]
        local = np.abs((points - place.xpos) @ place.xmat.reshape(3, 3))
        match mujoco.mjtGeom(self.model.geom_type[geom]):
            case mujoco.mjtGeom.mjGEOM_SPHERE:
                return np.linalg.norm(local, axis=1) - size[0]
            case mujoco.mjtGeom.mjGEOM_CAPSULE:
                local[:, 2] = np.maximum(local[:, 2] - size[1], 0.0)
                return np.linalg.norm(local, axis=1) - size[0]
            case mujoco.mjtGeom.mjGEOM_CYLINDER:
                beyond = np.stack([np.linalg.norm(local[:, :2], axis=1) - size[0], local[:, 2] - size[1]], axis=1)
            case mujoco.mjtGeom.mjGEOM_BOX:
                beyond = local - size
            case other:
                raise NotImplementedError(f"distance from a {other.name}")
        return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)


def compare(robot: Robot, poses: int, seed: int, *, by_pair: bool) -> dict[str, Any]:
    """Compare shapes and meshes in random poses, and how much of the meshes the shapes leave out."""
    rng = np.random.default_rng(seed)
    lower, upper = robot.model.jnt_range.T
    missed, invented, gaps = Counter[Pair](), Counter[Pair](), list[float]()
    real = found = false = pairs = pairs_found = 0
    for _ in range(poses):
        robot.put(rng.uniform(lower, upper))
        meshes, shapes = robot.meshes_that_touch(), robot.shapes_that_touch()
        real += bool(meshes)
        found += bool(meshes and shapes)
        false += bool(shapes and not meshes)
        pairs += len(meshes)
        pairs_found += len(meshes & shapes)
        missed.update(meshes - shapes)
        invented.update(shapes - meshes)
        if not shapes:
            gaps += [robot.gap(pair) for pair in meshes]
    left_out = {body: robot.outside(body) for body in robot.bodies}
    worst = max(left_out, key=lambda body: float(left_out[body].max()))
    if by_pair:
        for name, counts in (("missed", missed), ("invented", invented)):
            for (one, other), count in counts.most_common():
                print(f"    {name:>8} {count:5} {one} - {other}")
        for body, distances in left_out.items():
            share = (distances > 0.01).mean()
            print(f"     outside {1e3 * distances.max():5.1f} mm, {share:6.1%} by more than 10 mm  {body}")
    return {
        "poses": poses,
        "collisions": real,
        "found_share": found / max(real, 1),
        "pairs_found_share": pairs_found / max(pairs, 1),
        "false_alarm_share": false / max(poses - real, 1),
        "widest_missed_gap_mm": 1e3 * max(gaps, default=0.0),
        "worst_outside_mm": 1e3 * float(left_out[worst].max()),
        "worst_outside_link": worst,
        "outside_over_10mm_share": float(np.mean(np.concatenate(list(left_out.values())) > 0.01)),
        "geoms": int((robot.model.geom_contype > 0).sum()),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("arms", nargs="*", metavar="ARM", help=f"of {', '.join(ROBOTS)}; without any, all")
    parser.add_argument("--poses", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--by-pair", action="store_true", help="list pairs of links and links, too")
    args = parser.parse_args()
    if unknown := sorted(set(args.arms) - set(ROBOTS)):
        parser.error(f"no such arm: {', '.join(unknown)}; valid: {', '.join(ROBOTS)}")
    results: dict[str, Any] = {}
    print(f"{'arm':6} {'geoms':>5} {'collide':>11} {'found':>7} {'pairs':>7} {'false':>7} {'gap':>8} {'outside':>9}")
    for name in args.arms or ROBOTS:
        result = results[name] = compare(Robot(args.folder, *ROBOTS[name]), args.poses, args.seed, by_pair=args.by_pair)
        print(
            f"{name:6} {result['geoms']:5} {result['collisions']:5}/{result['poses']} {result['found_share']:7.1%} "
            f"{result['pairs_found_share']:7.1%} {result['false_alarm_share']:7.2%} "
            f"{result['widest_missed_gap_mm']:5.1f} mm {result['worst_outside_mm']:6.1f} mm "
            f"{result['worst_outside_link']}",
            flush=True,
        )
    print(json.dumps(results))


if __name__ == "__main__":
    main()
