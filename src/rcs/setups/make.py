"""`make` and `make_vec`: from names to environments."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import takewhile
from typing import Any, Literal, ParamSpec, TypeVar

from gymnasium.vector import AutoresetMode
from rcs_data.options import accepted, converted, require_whole

from rcs.devices import lookup
from rcs.envs.assemble import assemble, assemble_vec
from rcs.envs.env import Env
from rcs.envs.gates.gate import Gate
from rcs.envs.observer import Observer
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.task import Task
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.hardware.site import Site
from rcs.setups.resolve import AnyLayer, Hardware, devices_of, layers_by_robot, one_of
from rcs.setups.resolve import resolve as resolve
from rcs.setups.resolve import site_of as site_of
from rcs.sim.world import MOST

RENDER_MODES = (None, "rgb_array", "rgb_array_list", "human")

AnyGate = Gate | type[Gate] | str
AnyGates = Sequence[AnyGate] | Mapping[str, Mapping[str, Any]]
"""Gates, their classes, or their names, in the order in which targets pass them; or options by name."""
AnyLayers = Sequence[AnyLayer] | Mapping[str, Sequence[AnyLayer]]

Arguments = ParamSpec("Arguments")
Made = TypeVar("Made")


def _any_task(given: str | type[Task] | Setup) -> str: ...
def _any_layers(given: AnyLayers) -> tuple[str, ...]: ...
def _any_gates(given: AnyGates) -> Mapping[str, Mapping[str, Any]]: ...


class _Common(Setup):
    """Arguments of `make` and `make_vec`: the fields of a setup, and objects that no recording keeps."""

    task: str = converted(converter=_any_task, default="PickCuboid", kw_only=False)
    layers: tuple[str, ...] = converted(converter=_any_layers, default=())
    gates: Mapping[str, Mapping[str, Any]] = converted(converter=_any_gates, default_factory=dict)


class _Single(_Common):
    hardware: Site | Hardware | Mapping[str, Hardware] | None = None
    observers: Sequence[Observer] = ()
    render_mode: Literal["rgb_array", "rgb_array_list", "human"] | None = None


class _Copies(_Common):
    copies: int = field(default=2, kw_only=False)
    threads: int = 0
    autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP
    render_mode: None = None


def _takes(arguments: Callable[Arguments, object]) -> Callable[[Callable[..., Made]], Callable[Arguments, Made]]:
    """Give a function the signature of a record, for editors, type checkers and `help`."""

    def decorate(function: Callable[..., Made]) -> Callable[Arguments, Made]:
        shown, usual = inspect.signature(function), Setup()
        own = [one for one in shown.parameters.values() if one.kind is not one.VAR_KEYWORD]
        taken = {one.name for one in own}
        more = [
            inspect.Parameter(
                one.name, inspect.Parameter.KEYWORD_ONLY, default=getattr(usual, one.name), annotation=accepted(one)
            )
            for one in dataclasses.fields(Setup)  # pyright: ignore[reportArgumentType]
            if one.name not in taken
        ]
        vars(function)["__signature__"] = shown.replace(parameters=[*own, *more])
        return function

    return decorate


@_takes(_Single)
def make(
    task: str | type[Task] | Setup = "PickCuboid",
    *,
    hardware: Site | Hardware | Mapping[str, Hardware] | None = None,
    layers: AnyLayers = (),
    gates: AnyGates = (),
    observers: Sequence[Observer] = (),
    render_mode: Literal["rgb_array", "rgb_array_list", "human"] | None = None,
    **options: Any,
) -> Env:
    """Make an environment, simulated, real, or some of each.

    Args:
        task: A task by name, as a class or as `module:Class`; or a whole setup.
        hardware: Real devices: a `Site` or the path of its file, `driver:address` for all arms with their end
            effectors, or a mapping from names of robots, cameras and tactile sensors to addresses or devices. All else
            is simulated, in real time and in one world. None for simulation alone.
        layers: Your own layers on top of those of the setup, from the lowest to the highest, as objects, classes or
            names; for several robots, a sequence per robot by name. Leading names and classes are stored in the setup;
            objects, and anything after them, are not recorded and not replayed.
        gates: Gates that the targets of all robots pass before a device sees them: objects, classes or names, or a
            mapping from names to options, such as `{"Guard": {"on_hit": "clip"}}`. Leading names and classes are
            stored in the setup.
        observers: Observers of every step.
        render_mode: `rgb_array` for an environment whose `render` draws, `rgb_array_list` for one that draws every
            step, `human` for a window; None for none.
        options: Fields of `Setup`; their defaults and units are listed there.

    Raises:
        UnknownName: A task, robot, end effector, camera, layer or driver that does not exist.
        InvalidSetup: An option that does not make sense.

    Examples:
        >>> import rcs
        >>> env = rcs.make("PickCuboid", robot="fr3", control="joints", relative=True, frequency=30)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """
    if render_mode not in RENDER_MODES:
        raise InvalidSetup(f"render_mode is {render_mode!r}; valid: {', '.join(map(repr, RENDER_MODES))}.")
    parts = _parts(_setup(task, options), layers, gates)
    parts = replace(parts, devices=devices_of(hardware, parts), observers=list(observers))
    return assemble(parts, render_mode=render_mode)


@_takes(_Copies)
def make_vec(
    task: str | type[Task] | Setup = "PickCuboid",
    copies: int = 2,
    *,
    threads: int = 0,
    autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    layers: AnyLayers = (),
    gates: AnyGates = (),
    render_mode: None = None,
    **options: Any,
) -> VecEnv:
    """Make many copies of an environment that are stepped together on native threads.

    Args:
        task: A task by name, as a class or as `module:Class`; or a whole setup.
        copies: Number of copies.
        threads: Threads for physics and rendering, 0 for one per CPU.
        autoreset: When a copy starts its next episode: `NextStep`, `SameStep` or `Disabled` (gymnasium's).
        layers: Your own layers, as in `make`.
        gates: Gates, as in `make`; a guard of copies must have `on_hit="clip"`.
        render_mode: None; copies draw nothing but the frames of `cameras`.
        options: Fields of `Setup`; their defaults and units are listed there.

    Raises:
        UnknownName: A task, robot, end effector or camera that does not exist.
        InvalidSetup: An option that does not make sense.

    Examples:
        >>> import rcs
        >>> envs = rcs.make_vec("PickCuboid", copies=24, robot="fr3")
        >>> observations, infos = envs.reset(seed=0)
    """
    copies, threads = require_whole("copies", copies, 1, MOST), require_whole("threads", threads, 0, MOST)
    if render_mode is not None:  # pyright: ignore[reportUnnecessaryComparison]
        raise InvalidSetup(
            f"render_mode is {render_mode!r}, and copies draw no pictures besides those of their cameras; give "
            "cameras=(...) for frames in the observation, or film one environment: rcs.make(..., render_mode=...)."
        )
    setup = _setup(task, options)
    if setup.stepping == "realtime":
        raise InvalidSetup("Copies have no common wall clock; use stepping='async' or 'sync'.")
    try:
        mode = AutoresetMode(autoreset)
    except ValueError as err:
        valid = ", ".join(repr(one.value) for one in AutoresetMode)
        raise InvalidSetup(f"autoreset is {autoreset!r}; valid: {valid}.") from err
    return assemble_vec(_parts(setup, layers, gates), copies=copies, threads=threads, autoreset=mode)


def _setup(task: str | type[Task] | Setup, options: dict[str, Any]) -> Setup:
    if isinstance(task, Setup):
        if options:
            raise InvalidSetup(f"A setup was given and also {sorted(options)}; use dataclasses.replace on the setup.")
        return task
    fields = {one.name for one in dataclasses.fields(Setup)}
    if unknown := [name for name in options if name not in fields]:
        found: Any = lookup.find("task", lookup.name_of("task", task))
        if unknown[0] in {one.name for one in dataclasses.fields(found.Options)}:
            value = options[unknown[0]]
            raise InvalidSetup(
                f"{unknown[0]!r} is an option of the task {found.__name__}: task_options={{{unknown[0]!r}: {value!r}}}."
            )
    return Setup.from_json({"task": task, **options})


def _parts(setup: Setup, layers: AnyLayers, gates: AnyGates) -> Parts:
    """Return the parts that a setup names, with the user's layers and gates: those with a name in the setup itself."""
    if isinstance(gates, str):
        raise InvalidSetup(f"gates is the text {gates!r}; give a sequence, such as [{gates!r}].")
    named: list[Any] = [] if isinstance(gates, Mapping) else list(takewhile(_has_name, gates))
    own_gates = [] if isinstance(gates, Mapping) else list(gates)[len(named) :]
    by_name = gates if isinstance(gates, Mapping) else {lookup.name_of("gate", gate): {} for gate in named}
    setup = replace(setup, gates={**setup.gates, **by_name})
    if isinstance(layers, str):
        raise InvalidSetup(f"layers is the text {layers!r}; give a sequence, such as [{layers!r}].")
    if not isinstance(layers, Mapping):
        names: list[Any] = list(takewhile(_has_name, layers))
        setup, layers = replace(setup, layers=(*setup.layers, *names)), list(layers)[len(names) :]
    parts = resolve(setup)
    robots = [robot.name for robot in parts.robots]
    own = layers_by_robot(layers if isinstance(layers, Mapping) else dict.fromkeys(robots, layers), robots)
    return replace(
        parts,
        layers={name: [*parts.layers[name], *own.get(name, ())] for name in robots},
        gates=[*parts.gates, *(one_of("gate", gate, Gate) for gate in own_gates)],
    )


def _has_name(layer: AnyLayer | AnyGate) -> bool:
    """Return whether a name finds the layer or gate again; a class that is defined in a function has no such name."""
    return isinstance(layer, str) or (isinstance(layer, type) and "<locals>" not in layer.__qualname__)
