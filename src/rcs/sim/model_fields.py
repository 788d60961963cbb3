"""Ranges of any numeric field of a MuJoCo model, by its name there."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import cache
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Natural, Record

from rcs.errors import InvalidSetup, UnknownName

KINDS = {
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "cam": mujoco.mjtObj.mjOBJ_CAMERA,
    "dof": mujoco.mjtObj.mjOBJ_JOINT,
    "eq": mujoco.mjtObj.mjOBJ_EQUALITY,
    "flex": mujoco.mjtObj.mjOBJ_FLEX,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "jnt": mujoco.mjtObj.mjOBJ_JOINT,
    "light": mujoco.mjtObj.mjOBJ_LIGHT,
    "mat": mujoco.mjtObj.mjOBJ_MATERIAL,
    "pair": mujoco.mjtObj.mjOBJ_PAIR,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
}
"""Kinds of elements whose fields can vary, by the prefix of the fields' names."""
FIXED = {
    **dict.fromkeys(
        ("actuator_acc0", "actuator_length0", "body_invweight0", "body_subtreemass", "cam_mat0", "cam_pos0",
         "cam_poscom0", "dof_M0", "dof_invweight0", "dof_length", "light_dir0", "light_pos0", "light_poscom0",
         "tendon_invweight0", "tendon_length0"),
        "MuJoCo computes it from other fields",
    ),
    **dict.fromkeys(("geom_rbound", "geom_aabb"), "it follows geom_size"),
    **dict.fromkeys(
        ("flex_bending", "flex_node", "flex_node0", "flex_stiffness", "flex_texcoord", "flex_vert", "flex_vert0"),
        "its rows are no elements with names",
    ),
    "actuator_delay": "use action_latency",
}  # fmt: skip
"""Numeric fields that cannot vary, and why."""
MOVES_SURFACES = ("geom_size", "geom_pos", "geom_quat")
"""Fields that move the surfaces of geoms in their body."""
POSITIVE = ("body_mass", "body_inertia", "geom_size")
NOT_NEGATIVE = (
    "geom_friction", "geom_margin", "dof_damping", "dof_armature", "dof_frictionloss", "jnt_stiffness", "site_size",
    "tendon_damping", "tendon_stiffness", "actuator_armature", "actuator_damping", "light_intensity", "mat_rgba",
)  # fmt: skip
"""Fields that MuJoCo requires to be positive, or not negative."""
SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = SIMPLE_SHAPES = range(2, 7)
"""Kinds of geoms with a size of their own, in `mjtGeom`."""


class FieldRange(Record, kw_only=False):
    """A range of any numeric field of the MuJoCo model, drawn uniformly in every episode.

    It acts on the nominal values, or on what the named ranges of a `Randomisation` and earlier field ranges have made
    of them in the same episode. The library keeps bounding volumes and derived constants up to date, and quaternions
    and axes at unit length; masses and inertias do not follow sizes.

    Examples:
        >>> FieldRange("geom_friction", 0.3, 1.2, names="cuboid*", operation="set", axes=(0,)).key
        'geom_friction[cuboid*, 0]'
    """

    field: str
    """Name in `mujoco.MjModel`, such as `geom_friction` or `dof_armature`."""
    low: float
    """Lowest factor, summand or value, in MuJoCo's unit of the field."""
    high: float
    """Highest factor, summand or value."""
    names: str | tuple[str, ...] = "*"
    """Names of the elements, or patterns with `*` and `?`. Elements without a name have that of their body, degrees of
    freedom that of their joint."""
    operation: Literal["scale", "add", "set"] = "scale"
    """Use of a draw: as a factor, as a summand, or as the new value."""
    axes: tuple[Natural, ...] | None = None
    """Columns of a field with several numbers per element; None for all."""
    per: Literal["value", "element", "all"] = "value"
    """Number of draws: one for each value, one for each element, or one for all."""

    def __post_init__(self) -> None:
        """Check the range and the name of the field.

        Raises:
            InvalidSetup: The range is empty, a factor is not positive, or the field cannot vary.
        """
        super().__post_init__()
        if not self.low <= self.high or (self.operation == "scale" and self.low <= 0):
            what = "factors above 0" if self.operation == "scale" else "numbers"
            raise InvalidSetup(f"{self.key} is from {self.low:g} to {self.high:g}; valid: two {what}, the lower first.")
        if reason := FIXED.get(self.field):
            raise InvalidSetup(f"{self.field} cannot vary: {reason}.")
        if self.field not in variable_fields():
            if hasattr(mujoco.MjModel, self.field):
                raise InvalidSetup(f"{self.field} cannot vary: it belongs to the structure of the model.")
            names = variable_fields()
            same_kind = [name for name in names if name.startswith(f"{self.kind}_")]
            raise InvalidSetup(UnknownName("numeric field of MjModel", self.field, same_kind or names).message)

    @property
    def kind(self) -> str:
        """The kind of elements, a key of `KINDS`."""
        return self.field.partition("_")[0]

    @property
    def key(self) -> str:
        """The key of its draws."""
        patterns = (self.names,) if isinstance(self.names, str) else self.names
        return f"{self.field}[{', '.join(map(str, (*patterns, *(self.axes or ()))))}]"


@cache
def variable_fields() -> tuple[str, ...]:
    """Return the names of all fields of a model that a `FieldRange` can vary."""
    empty = mujoco.MjModel.from_xml_string("<mujoco/>")
    names = [name for name in dir(mujoco.MjModel) if name.partition("_")[0] in KINDS and not name.endswith("_user")]
    return tuple(
        name
        for name in names
        if isinstance(values := getattr(empty, name), np.ndarray) and values.dtype.kind == "f" and name not in FIXED
    )


def names_of(model: mujoco.MjModel, kind: str) -> list[str]:
    """Return the names of all elements of a kind: their own, or that of their joint or body."""
    if kind == "dof":
        joints = names_of(model, "jnt")
        return [joints[joint] for joint in model.dof_jntid]
    count = getattr(model, "njnt" if kind == "jnt" else "nu" if kind == "actuator" else f"n{kind}")
    own = [mujoco.mj_id2name(model, KINDS[kind], i) or "" for i in range(count)]
    bodies = getattr(model, f"{kind}_bodyid", None)
    if bodies is not None:
        own = [name or model.body(int(body)).name for name, body in zip(own, bodies, strict=True)]
    return [name or f"{kind} {i}" for i, name in enumerate(own)]


def find_rows(model: mujoco.MjModel, wanted: FieldRange) -> tuple[NDArray[np.intp], list[str]]:
    """Return rows and names of the elements of a field range; the body of the world is none of them.

    Raises:
        InvalidSetup: A pattern matches nothing, the field has no such column, or MuJoCo allows no such values.
    """
    names = names_of(model, wanted.kind)
    first = 1 if wanted.kind == "body" else 0
    rows: set[int] = set()
    for pattern in (wanted.names,) if isinstance(wanted.names, str) else wanted.names:
        found = [i for i, name in enumerate(names) if i >= first and fnmatchcase(name, pattern)]
        if not found:
            known = sorted(set(names[first:]))
            raise InvalidSetup(UnknownName(f"{wanted.kind} in this scene for {wanted.field}", pattern, known).message)
        rows |= set(found)
    chosen = np.array(sorted(rows), np.intp)
    nominal = getattr(model, wanted.field)[chosen]
    if wanted.axes is not None:
        columns = nominal.shape[1] if nominal.ndim == 2 else 0
        if not wanted.axes or max(wanted.axes) >= columns:
            valid = f"columns from 0 to {columns - 1}" if columns else "None, since an element has one number"
            raise InvalidSetup(f"axes of {wanted.field} is {wanted.axes}; valid: {valid}.")
        nominal = nominal[:, wanted.axes]
    # Zeros where numbers must be positive are unused columns of a size, or of bodies without mass.
    smallest = float(nominal.min(initial=np.inf, where=nominal > 0 if wanted.field in POSITIVE else True))
    least = {"scale": smallest * wanted.low, "add": smallest + wanted.low}.get(wanted.operation, wanted.low)
    if least < 0 and wanted.field in NOT_NEGATIVE:
        raise InvalidSetup(f"{wanted.key} reaches {least:g}; valid: values from 0.")
    if least <= 0 and wanted.field in POSITIVE:
        raise InvalidSetup(f"{wanted.key} reaches {least:g}; valid: values above 0.")
    adds_less = wanted.operation == "add" and wanted.low < 0
    if adds_less and wanted.field in ("body_mass", "body_inertia") and (nominal == 0).any():
        raise InvalidSetup(f"{wanted.key} reaches {wanted.low:g} for a body without mass; valid: values from 0.")
    if wanted.field == "geom_size" and (fixed := [i for i in chosen if model.geom_type[i] not in SIMPLE_SHAPES]):
        raise InvalidSetup(f"geom_size of {names[fixed[0]]!r} cannot vary; simple shapes alone have their own size.")
    if wanted.field in ("body_ipos", "body_iquat") and (simple := [i for i in chosen if model.body_simple[i]]):
        raise InvalidSetup(
            f"{wanted.field} of {names[simple[0]]!r} cannot vary: MuJoCo has compiled the body with its inertia in its "
            "origin. Give it one off its origin in its model."
        )
    return chosen, [names[i] for i in chosen]


def prepare_model(model: mujoco.MjModel, wanted: Iterable[FieldRange]) -> None:
    """Prepare a compiled model for fields that will vary, before a world uses it.

    MuJoCo skips positions that are zero when it compiles, and its bounding boxes within bodies are of that moment.
    """
    for one in wanted:
        rows, _ = find_rows(model, one)
        if one.field in MOVES_SURFACES:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE.value
        if one.field in ("geom_pos", "geom_quat", "site_pos", "site_quat", "body_ipos", "body_iquat"):
            getattr(model, f"{one.kind}_sameframe")[rows] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value


def bounds_of(types: NDArray[np.int32], sizes: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return radius and box around geoms of simple shapes, as MuJoCo's compiler does.

    Args:
        types: Their `mjtGeom`, (geoms,).
        sizes: Their sizes [m], (..., geoms, 3).

    Returns:
        `geom_rbound` (..., geoms) and `geom_aabb` (..., geoms, 6).
    """
    x, y = sizes[..., 0], sizes[..., 1]
    cases = {
        SPHERE: (np.stack([x, x, x], -1), x),
        CAPSULE: (np.stack([x, x, x + y], -1), x + y),
        ELLIPSOID: (sizes, sizes.max(axis=-1)),
        CYLINDER: (np.stack([x, x, y], -1), np.hypot(x, y)),
        BOX: (sizes, np.linalg.norm(sizes, axis=-1)),
    }
    half, radius = np.empty_like(sizes), np.empty_like(x)
    for kind, (own_half, own_radius) in cases.items():
        chosen = types == kind
        half[..., chosen, :], radius[..., chosen] = own_half[..., chosen, :], own_radius[..., chosen]
    return radius, np.concatenate([np.zeros_like(half), half], axis=-1)
