"""Fields of the model that are varied by their names in MuJoCo."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rcs.sim.model_fields import FieldRange, bounds_of, find_rows
from rcs.sim.world import Copies

if TYPE_CHECKING:  # the randomiser calls this module
    from rcs.envs.variation.randomiser import Randomiser, Values

UNIT_LENGTH = ("quat", "_axis", "_dir")
"""Ends of the names of fields whose rows have a length of one."""
WITHOUT_CONSTANTS = ("geom", "light", "mat", "pair")
"""Kinds of elements from which MuJoCo derives no constants."""


def add_fields(vary: Randomiser) -> None:
    """Vary the fields of the model that the randomisation names, in their order."""
    for wanted in vary.ranges.fields:
        _add_field(vary, wanted)


def _add_field(vary: Randomiser, wanted: FieldRange) -> None:
    model = vary.world.model
    found, names = find_rows(model, wanted)
    # What is written before in an episode is the base of this range.
    is_base = np.isin(found, list(vary.written.get(wanted.field, ())))
    rows = vary.rows(wanted.field, found)
    nominal = rows.nominal.reshape(len(found), -1)
    columns = np.arange(nominal.shape[1]) if wanted.axes is None else np.array(wanted.axes)
    owners = ["all"] if wanted.per == "all" else names
    each = (len(columns),) if wanted.per == "value" and rows.nominal.ndim > 1 else ()
    shape = (len(owners), *each)
    if not vary.enable(wanted.key, owners, each=each, bounds=(np.full(shape, wanted.low), np.full(shape, wanted.high))):
        return
    vary.changes_constants |= wanted.kind not in WITHOUT_CONSTANTS
    bounds = [vary.rows(name, found) for name in ("geom_rbound", "geom_aabb") if wanted.field == "geom_size"]

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        draws = drawn[wanted.key] if each else drawn[wanted.key][..., None]
        values = np.array(rows.read(copies), np.float64).reshape(*draws.shape[:-2], *nominal.shape)
        values[..., ~is_base, :] = nominal[~is_base]
        chosen = values[..., columns]
        if wanted.operation == "scale":
            chosen *= draws
        elif wanted.operation == "add":
            chosen += draws
        else:
            chosen[...] = draws
        values[..., columns] = chosen
        if wanted.field.endswith(UNIT_LENGTH):
            values /= np.sqrt((values * values).sum(axis=-1, keepdims=True))
        elif wanted.field.endswith("rgba"):
            np.clip(values, 0.0, 1.0, out=values)
        rows.write(values.reshape(*draws.shape[:-2], *rows.nominal.shape), copies)
        for own, bound in zip(bounds, bounds_of(model.geom_type[found], values) if bounds else (), strict=True):
            own.write(bound, copies)

    vary.write_with(write)
