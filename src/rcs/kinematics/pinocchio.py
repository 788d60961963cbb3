"""Kinematics by Pinocchio, a second backend behind the same interface; `pip install 'robot-control-stack[pinocchio]'`.

The chain comes from the compiled model of MuJoCo, joint by joint. Pinocchio's own reader of MJCF knows no includes and
leaves out bodies without a word. The solver is in Python and takes hundreds of times as long as the built-in one; it is
there for those who go on with Pinocchio's model (`model`, `frame`), and to check one against the other.
"""

from __future__ import annotations

import importlib
import threading
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import IkOptions, IkResult, IkStatus, Kinematics
from rcs.errors import InvalidSetup, MissingDependency
from rcs.spatial import Pose, wxyz_to_xyzw

STEP = 0.5
"""Largest change of a joint per iteration [rad], beyond which the Jacobian does not hold."""
FOLLOWED = 0.2
"""The same when following, so that the TCP's way is straight [rad]."""
STANDSTILL = 1e-4
"""Largest change of a joint in an iteration that changes nothing that matters [rad]."""
MORE_DAMPING = 8.0
"""Factor of the damping after a step without progress, when following."""
FULFILLED = 0.25
"""Share of the promised decrease of the squared error that a step must bring, when following."""
ASKED = 0.03, 10.0
"""Weight of a radian against a metre when following: larger for the part that the target does not change."""
LARGEST_RETURN = 0.5
"""Share of the way to the preferred joints per iteration, at most."""

Vector = NDArray[np.float64]


def package() -> Any:
    """Import and return Pinocchio.

    Raises:
        MissingDependency: It is not installed; the message names the extra.
    """
    try:
        return importlib.import_module("pinocchio")
    except ImportError as err:
        raise MissingDependency(
            "backend='pinocchio' needs Pinocchio: pip install 'robot-control-stack[pinocchio]'."
        ) from err


@dataclass
class _Search:
    """One attempt: where it has come to, and how."""

    joints: Vector
    translation: float = np.inf
    rotation: float = np.inf
    is_reached: bool = False
    is_at_edge: bool = False


class PinocchioKinematics(Kinematics):
    """Forward and inverse kinematics of one arm by Pinocchio. Options and statuses are those of the built-in solver."""

    def __init__(self, model: mujoco.MjModel, joints: list[int], tcp_site: int, base_body: int) -> None:
        """Take the chain out of a compiled model.

        Args:
            model: The model; it is not kept.
            joints: Ids of its hinges and slides, base to tip.
            tcp_site: Id of the site at the TCP.
            base_body: Id of the body whose frame poses are in.

        Raises:
            MissingDependency: Pinocchio is not installed.
            InvalidSetup: The base does not carry the TCP, or a joint is of another kind.
        """
        super().__init__()
        self._pin = package()
        self.model, self.frame, self._order = _chain(self._pin, model, joints, tcp_site, base_body)
        """Pinocchio's model of the chain, and in it the number of the frame at the TCP."""
        limited = model.jnt_limited[joints].astype(bool)
        self._lower = np.where(limited, model.jnt_range[joints, 0], -2 * np.pi)
        self._upper = np.where(limited, model.jnt_range[joints, 1], 2 * np.pi)
        self._own = threading.local()  # Pinocchio's data, one per thread

    def _dof(self) -> int:
        return len(self._order)

    def _joint_lower(self) -> list[float]:
        return self._lower.tolist()

    def _joint_upper(self) -> list[float]:
        return self._upper.tolist()

    def _forward(self, joints: Vector) -> Pose:
        placement = self._place(joints)
        return Pose(placement.translation, self._pin.Quaternion(placement.rotation).coeffs())

    def _jacobian(self, joints: Vector) -> Vector:
        local = self._pin.LOCAL_WORLD_ALIGNED
        q = np.ascontiguousarray(joints[self._order])
        jacobian = np.zeros((6, len(q)))
        jacobian[:, self._order] = self._pin.computeFrameJacobian(self.model, self._data(), q, self.frame, local)
        return jacobian

    def _inverse(self, target: Pose, start: Vector, options: IkOptions) -> IkResult:
        # A joint that is found outside is followed from where it is.
        begin = start if options.best_effort else np.clip(start, self._lower, self._upper)
        self._require(options)
        goal = self._pin.SE3(target.matrix)
        count = [0]
        random = np.random.default_rng(options.seed)
        first = found = self._attempt(goal, begin, options.max_step if options.best_effort else (), options, count)
        best = min(found.translation, np.inf), found.rotation
        restart = 0
        while not (found.is_reached or found.is_at_edge) and restart < options.restarts:
            restart += 1
            found = self._attempt(goal, random.uniform(self._lower, self._upper), (), options, count)
            if found.translation + found.rotation < sum(best):
                best = found.translation, found.rotation
        if not (found.is_reached or found.is_at_edge):
            answer, status = (first.joints, IkStatus.nearest) if options.best_effort else (begin, IkStatus.infeasible)
            return IkResult(answer.tolist(), status, *best, count[0])
        way = found.joints - begin
        share = 1.0
        if len(options.max_step):
            share = min(1.0, float(np.min(options.max_step / np.maximum(np.abs(way), 1e-300))))
        is_far = share < 1.0 or found.is_at_edge
        answer = begin + share * way if share < 1.0 else found.joints
        status = IkStatus.clamped if is_far else IkStatus.ok
        return IkResult(answer.tolist(), status, found.translation, found.rotation, count[0])

    def _attempt(self, goal: Any, begin: Vector, max_step: ArrayLike, options: IkOptions, count: list[int]) -> _Search:
        """Go from joints towards a pose, by `max_step` at most."""
        bound = np.asarray(max_step, np.float64)
        search = _Search(begin.copy())
        q = search.joints
        error = self._error(goal, q)
        translation, rotation = _sizes(error)
        is_relaxed = options.rotation_weight < 1.0
        weight = options.rotation_weight
        if options.best_effort and not is_relaxed:
            weight = float(np.clip(translation / max(rotation, 1e-12), *ASKED))
        scale = np.repeat([1.0, weight], 3)
        damping, largest = options.damping, np.inf
        jacobian: Vector | None = None
        for iteration in range(options.iterations + 1):
            is_met = translation <= options.translation_tolerance and rotation <= options.rotation_tolerance
            is_last = largest < STANDSTILL or iteration == options.iterations
            if is_met and (not is_relaxed or is_last):
                search.is_reached = True
            if search.is_reached or search.is_at_edge or is_last:
                break
            count[0] += 1
            if jacobian is None:
                jacobian = scale[:, None] * self._jacobian(q)
            step, share, is_at_edge = self._step(q, jacobian, scale * error, begin, bound, damping, options)
            largest = float(np.abs(step).max())
            candidate = np.clip(q + share * step, *self._range(begin))
            new_error = self._error(goal, candidate)
            if options.best_effort:
                cost, left = ((scale * error) ** 2).sum(), scale * error - share * (jacobian @ step)
                if cost - ((scale * new_error) ** 2).sum() <= FULFILLED * max(cost - (left**2).sum(), 0.0):
                    damping *= MORE_DAMPING
                    continue
            q, error, jacobian = candidate, new_error, None
            translation, rotation = _sizes(error)
            damping = max(damping / MORE_DAMPING, options.damping)
            search.is_at_edge = is_at_edge
        search.joints, search.translation, search.rotation = q, translation, rotation
        return search

    def _range(self, begin: Vector) -> tuple[Vector, Vector]:
        """Return the limits, and where a joint begins outside, that place in their stead."""
        return np.minimum(self._lower, begin), np.maximum(self._upper, begin)

    def _step(
        self,
        q: Vector,
        jacobian: Vector,
        error: Vector,
        begin: Vector,
        bound: Vector,
        damping: float,
        options: IkOptions,
    ) -> tuple[Vector, float, bool]:
        """Return the step, the share of it to make, and whether that ends at the bound; limits are inside the solve."""
        most = FOLLOWED if options.best_effort else STEP
        lower, upper = self._range(begin)
        free = np.ones(len(q), bool)
        step, share, is_at_edge = np.zeros(len(q)), 1.0, False
        for _ in range(len(q) + 1 if options.best_effort else 2):
            own = jacobian[:, free]
            left = error - jacobian[:, ~free] @ step[~free]
            step[free] = own.T @ np.linalg.solve(own @ own.T + damping * np.eye(6), left)
            if len(options.preferred):
                pull = min(options.preferred_weight * float(np.abs(step).max()), LARGEST_RETURN)
                rest = pull * (options.preferred - q)[free]
                step[free] += rest - own.T @ np.linalg.solve(own @ own.T + 1e-8 * np.eye(6), own @ rest)
            share, is_at_edge = min(1.0, most / max(float(np.abs(step).max()), 1e-300)), False
            if len(bound):
                room = bound - np.sign(step) * (q - begin)
                allowed = np.min(np.maximum(room, 0.0) / np.maximum(np.abs(step), 1e-300))
                share, is_at_edge = min(share, float(allowed)), bool(allowed < share)
            reach = q + (share * step if options.best_effort else 0.0)
            limit = np.where(step < 0, lower, upper)
            blocked = free & (step != 0) & np.where(step < 0, reach <= limit, reach >= limit)
            if not blocked.any():
                break
            step[blocked] = (limit - q)[blocked] / share if share > 0 else 0.0
            free &= ~blocked
        return step, share, is_at_edge

    def _require(self, options: IkOptions) -> None:
        for rows in (options.max_step, options.preferred):
            if len(rows) not in (0, len(self._order)):
                raise InvalidSetup(
                    "inverse kinematics: max_step and preferred must have one entry for each of the "
                    f"{len(self._order)} joints or none, one has {len(rows)}"
                )

    def _error(self, goal: Any, joints: Vector) -> Vector:
        """Return what takes the TCP to its goal: translation [m] and rotation vector [rad], in the base frame."""
        here = self._place(joints)
        return np.append(goal.translation - here.translation, self._pin.log3(goal.rotation @ here.rotation.T))

    def _place(self, joints: Vector) -> Any:
        data = self._data()
        self._pin.framesForwardKinematics(self.model, data, np.ascontiguousarray(joints[self._order]))
        return data.oMf[self.frame]

    def _data(self) -> Any:
        if not hasattr(self._own, "data"):
            self._own.data = self.model.createData()
        return self._own.data


def _chain(
    pin: Any, model: mujoco.MjModel, joints: list[int], tcp_site: int, base_body: int
) -> tuple[Any, int, NDArray[np.intp]]:
    """Return Pinocchio's model of a chain, its frame at the TCP, and which given joint each of its joints is."""
    bodies: list[int] = []
    body = int(model.site_bodyid[tcp_site])
    while body != base_body:
        if body == 0:
            raise InvalidSetup("inverse kinematics: the base body does not carry the TCP")
        bodies.append(body)
        body = int(model.body_parentid[body])
    chain, parent, fixed = pin.Model(), 0, pin.SE3.Identity()
    order: list[int] = []
    for body in reversed(bodies):
        fixed = fixed * _placement(pin, model.body_pos[body], model.body_quat[body])
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if joint not in joints:
                continue  # stays where the model has it
            kinds = {mujoco.mjtJoint.mjJNT_HINGE: pin.JointModelRevoluteUnaligned,
                     mujoco.mjtJoint.mjJNT_SLIDE: pin.JointModelPrismaticUnaligned}  # fmt: skip
            kind = mujoco.mjtJoint(model.jnt_type[joint])
            if kind not in kinds:
                raise InvalidSetup("inverse kinematics: only hinge and slide joints are supported")
            axis, anchor = np.array(model.jnt_axis[joint]), np.array(model.jnt_pos[joint])
            fixed = fixed * pin.SE3(np.eye(3), anchor)
            parent = chain.addJoint(parent, kinds[kind](axis), fixed, model.joint(joint).name)
            order.append(joints.index(joint))
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            is_hinge = kind == mujoco.mjtJoint.mjJNT_HINGE
            back = (
                pin.SE3(pin.exp3(-reference * axis), np.zeros(3)) if is_hinge else pin.SE3(np.eye(3), -reference * axis)
            )
            fixed = back * pin.SE3(np.eye(3), -anchor)
    if len(order) != len(joints):
        raise InvalidSetup("inverse kinematics: a joint does not move the TCP; with Pinocchio every joint must")
    tcp = fixed * _placement(pin, model.site_pos[tcp_site], model.site_quat[tcp_site])
    frame = chain.addFrame(pin.Frame("tcp", parent, tcp, pin.FrameType.OP_FRAME))
    return chain, int(frame), np.array(order)


def _placement(pin: Any, position: ArrayLike, wxyz: ArrayLike) -> Any:
    turn = pin.Quaternion(np.array(wxyz_to_xyzw(np.array(wxyz, np.float64)), np.float64)).normalized()
    return pin.SE3(turn.matrix(), np.array(position, np.float64))


def _sizes(error: Vector) -> tuple[float, float]:
    return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
