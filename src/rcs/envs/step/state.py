"""The whole state of an environment: everything that decides what follows, to go back to it or to branch off from it.

An environment and every copy of a batch that were made from the same parts can go on from each other's states, with the
same bits. Layers and tasks name what they remember in `memory`.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.spaces import Observation
from rcs.errors import InvalidSetup, WrongOrder

if TYPE_CHECKING:
    from rcs.envs.step.engine import Engine
    from rcs.sim.world import World

Rows = NDArray[Any] | dict[str, "Rows"]
"""Arrays (copies, ...), in any nesting."""


@dataclass(frozen=True, kw_only=True)
class EnvState:
    """States of one or several copies of an environment. It survives pickling; `state[i]` is that of one copy."""

    origin: Mapping[str, Any]
    """Description of the environment, by which it differs from others."""
    world: NDArray[np.float64]
    """State of the simulation, what its callbacks remember and what was read out, (copies, values)."""
    episode: dict[str, Rows]
    """Seed and number of the episode, steps so far, whether it is over."""
    memory: dict[str, Rows]
    """Memory of layers, task, random numbers and cameras."""
    fields: dict[str, Rows]
    """Fields of the model that differ between copies or episodes, such as sizes and colours."""

    def __len__(self) -> int:
        """Return the number of copies."""
        return len(self.world)

    def __getitem__(self, copies: int | slice | NDArray[np.integer] | Sequence[int]) -> EnvState:
        """Return the states of some of the copies."""
        index = [copies] if isinstance(copies, int | np.integer) else copies
        chosen: dict[str, Any] = {
            one.name: _chosen(getattr(self, one.name), index) for one in fields(self) if one.name != "origin"
        }
        return EnvState(origin=self.origin, **chosen)


def read_state(engine: Engine, copies: NDArray[np.int32]) -> EnvState:
    """Return the state of some copies of a simulated environment.

    Raises:
        WrongOrder: The environment drives real devices, or its first episode has not begun.
    """
    simulation = engine.simulation
    if simulation is None or any(port.can_fail for port in engine.stack.ports):
        raise WrongOrder("The state of real devices can neither be read nor set; it can in simulation.")
    engine.require_running()
    engine.rebase_if_held()
    leading = engine.leading
    memory = {name: _rows_of(part, own, copies) for name, (part, own) in _parts(engine).items()}
    return EnvState(
        origin=_origin(engine),
        world=simulation.world.save(copies),
        episode={name: np.atleast_1d(own)[copies] for name, own in engine.counters().items()},
        memory={name: rows for name, rows in memory.items() if rows},
        fields={name: _row(simulation.world.field(name), leading, copies) for name in simulation.world.varied},
    )


def write_state(engine: Engine, state: EnvState, copies: NDArray[np.int32]) -> Observation:
    """Set the state of some copies, and return the observation of all; a state of one copy is set in all of them.

    Raises:
        InvalidSetup: It is not a state, that of another environment, or of another number of copies.
        WrongOrder: The environment drives real devices, or its first episode has not begun.
    """
    if not isinstance(state, EnvState):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InvalidSetup(f"The state is a {type(state).__name__}; valid is what get_state returned.")
    mine = read_state(engine, copies[:1])
    for what in mine.origin:
        given = state.origin.get(what)
        if given != mine.origin[what]:
            raise InvalidSetup(f"The state is of another environment: its {what} is {given}; here {mine.origin[what]}.")
    if len(state) == 1:
        state = state[np.zeros(len(copies), np.intp)]
    if len(state) != len(copies):
        raise InvalidSetup(f"The state is of {len(state)} copies; valid is one, or as many as are set, {len(copies)}.")
    assert engine.simulation is not None, "read_state has checked it"
    world = engine.simulation.world
    # Fields without values in the state were not varied when it was read.
    nominal = {name: np.repeat(world.nominal(name)[None], len(copies), axis=0) for name in world.varied}
    state = replace(state, fields={**nominal, **state.fields})
    own = _form(mine) | {f"fields/{name}": np.shape(getattr(world.model, name, ())) for name in state.fields}
    if (form := _form(state)) != own:
        differing = sorted(name for name in form.keys() | own.keys() if form.get(name) != own.get(name))
        raise InvalidSetup(f"The state is of another environment: it differs in {', '.join(differing)}.")
    # Randomised figures of the models come first: what is computed from the state depends on them.
    _write_memory(engine, state, copies)
    _write_fields(world, state, copies)
    world.load(state.world, copies)
    engine.set_counters({name: np.asarray(rows) for name, rows in state.episode.items()}, copies)
    observation = engine.go_on(copies)
    _write_memory(engine, state, copies)  # layers may have taken this for one observation more
    return observation


def _write_fields(world: World, state: EnvState, copies: NDArray[np.int32]) -> None:
    fields: dict[str, Any] = state.fields
    for name, rows in fields.items():
        world.vary(name)[copies if world.leading else ...] = rows if world.leading else rows[0]
    if state.fields:
        world.update_constants(copies if world.leading else None)


def _write_memory(engine: Engine, state: EnvState, copies: NDArray[np.int32]) -> None:
    for name, (part, leading) in _parts(engine).items():
        if name in state.memory:
            _write(part, state.memory[name], leading, copies)


def _parts(engine: Engine) -> dict[str, tuple[Any, tuple[int, ...]]]:
    """Return whatever remembers something beside the world, by name, with the leading shape of its arrays."""
    simulation = engine.simulation
    assert simulation is not None, "it is simulated"
    leading = engine.leading
    parts: dict[str, tuple[Any, tuple[int, ...]]] = {
        "task": (simulation.task, leading),
        "rewards": (simulation.rewards, leading),
    }
    for i, randomiser in enumerate(simulation.randomisers):
        parts[f"randomiser {i}"] = randomiser, leading
    if simulation.frame_clock is not None:
        parts["frame clock"] = simulation.frame_clock, (simulation.world.copies,)
    for chain, own in engine.stack.chains.items():
        for i, part in enumerate([*own.layers, *own.ports]):
            parts[f"{chain}{'/' if chain else ''}{i} {type(part).__name__}"] = part, leading
    for i, gate in enumerate(engine.stack.gates):
        parts[f"gate {i} {type(gate).__name__}"] = gate, leading
    return parts


def _origin(engine: Engine) -> dict[str, Any]:
    simulation = engine.simulation
    assert simulation is not None, "it is simulated"
    world = simulation.world
    return {
        "task": type(simulation.task).__name__,
        "robots": [robot.placement.name for robot in simulation.robots],
        "stepping": world.stepping,
        "frequency": world.frequency,
        "physics step": world.model.opt.timestep,
        "layers": [type(layer).__name__ for layer in engine.stack.layers],
        "scene": zlib.crc32(world.model.names + world.model.qpos0.tobytes()),
        "size of the simulation's state": world.core.save_size,
    }


def _rows_of(owner: Any, leading: tuple[int, ...], copies: NDArray[np.int32]) -> dict[str, Rows]:
    """Return what an object remembers of some copies: arrays (*leading, ...), and in turn what its parts remember."""
    rows: dict[str, Rows] = {}
    for name in getattr(owner, "memory", ()):
        value = _get(owner, name)
        if value is None:  # not remembered yet
            continue
        has_parts = hasattr(value, "memory")
        rows[name] = _rows_of(value, leading, copies) if has_parts else _row(value, leading, copies)
    return rows


def _row(value: Any, leading: tuple[int, ...], copies: NDArray[np.int32]) -> Rows:
    if isinstance(value, Mapping):
        return {key: _row(own, leading, copies) for key, own in value.items()}
    array = np.asarray(value)
    if not leading:
        return array[None].copy()
    return array[copies] if array.ndim else np.repeat(array, len(copies))  # a number is that of all copies


def _write(owner: Any, rows: Any, leading: tuple[int, ...], copies: NDArray[np.int32]) -> None:
    for name, given in rows.items():
        value = _get(owner, name)
        if hasattr(value, "memory") and isinstance(given, dict):
            _write(value, given, leading, copies)
        else:
            setattr(owner, name, _merged(value, given, leading, copies))


def _merged(value: Any, given: Any, leading: tuple[int, ...], copies: NDArray[np.int32]) -> Any:
    """Return a new value with the rows of some copies replaced."""
    if isinstance(given, dict):
        old = value if isinstance(value, Mapping) else {}
        return {**old, **{key: _merged(old.get(key), own, leading, copies) for key, own in given.items()}}
    if not leading:
        return np.array(given[0])
    merged = np.array(np.broadcast_to(given[0] if value is None else value, (*leading, *given.shape[1:])))
    merged[copies] = given
    return merged


def _get(owner: Any, name: str) -> Any:
    try:
        return getattr(owner, name)
    except AttributeError as err:
        raise InvalidSetup(f"{type(owner).__name__} names {name!r} in `memory`, and has no such attribute.") from err


def _chosen(rows: Any, index: Any) -> Any:
    return {name: _chosen(own, index) for name, own in rows.items()} if isinstance(rows, dict) else rows[index]


def _form(state: EnvState) -> dict[str, Any]:
    """Return shapes and kinds of all parts, without the number of copies."""
    form: dict[str, Any] = {"world": state.world.shape[1:]}

    def add(prefix: str, rows: Any) -> None:
        if isinstance(rows, dict):
            for name, own in rows.items():
                add(f"{prefix}/{name}", own)
        else:
            form[prefix] = rows.shape[1:]

    for part in ("episode", "memory", "fields"):
        add(part, getattr(state, part))
    return form
