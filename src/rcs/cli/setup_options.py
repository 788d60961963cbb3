"""Options of commands that make an environment: the fields of a setup, with the names and meanings of Python."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import textwrap
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, make_dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro
from rcs_data.options import Record
from tyro.constructors import PrimitiveConstructorSpec

from rcs.agents.agent import is_path
from rcs.envs.cameras import ALL, USUAL_SIZE, Cameras
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.hardware.site import Site
from rcs.setups.resolve import with_camera_names
from rcs.sim.randomisation import Preset
from rcs.sim.world import Stepping

OF_CAMERAS = {"names": "cameras", "mode": "camera_mode", "fps": "camera_fps", "noise": "camera_noise"}
"""Options for fields of `Cameras` that would be unclear beside those of a setup."""
LEFT_OUT = ("task", "cameras", "mounts")
"""Fields that have no option of their own."""


@dataclass(frozen=True)
class Unset:
    """The value of an option that is not given."""

    shown: str
    """Its default in words."""


def flags(shown: str | None = None, **defaults: str) -> type[Any]:
    """Return a dataclass with an option for every field of a setup; those not given are `Unset`.

    Args:
        shown: The default of all options in words; None for that of each field.
        defaults: Defaults of some options in words, where they differ.
    """
    made: list[tuple[str, Any, Any]] = []
    for record in (Setup, Cameras):
        kinds, texts, usual = get_type_hints(record, include_extras=True), _texts(record), record()
        for own in dataclasses.fields(record):  # pyright: ignore[reportArgumentType]
            if own.name in LEFT_OUT:
                continue
            name = OF_CAMERAS.get(own.name, own.name) if record is Cameras else own.name
            kind = Preset if own.name == "randomisation" else kinds[own.name]
            default = Unset(defaults.get(name) or shown or _in_words(getattr(usual, own.name)))
            made.append((name, _option(name, kind, texts[own.name]), field(default=default)))
    return make_dataclass("Flags", made, kw_only=True)


def _option(name: str, kind: Any, text: str) -> Any:
    parts = _parts(kind)
    choices = tuple(str(one) for part in parts if get_origin(part) is Literal for one in get_args(part))
    choices = choices or (("true", "false") if bool in parts else ())
    is_many = bool({tuple, Mapping, bool, Any} & set(parts)) or name == "randomisation"
    word = f"{{{','.join(choices)}}}" if choices else _word_for(name, parts)
    repeats = "" if choices and tuple not in parts else " ..."
    spec = PrimitiveConstructorSpec(
        nargs="*" if is_many else 1,
        metavar=f"[{word}{repeats}]" if is_many else word,
        instance_from_str=lambda words: _value(name, words, kind),
        is_instance=lambda _: True,
        str_from_instance=lambda value: value.shown.split(),
        choices=choices or None,
    )
    return Annotated[Any, spec, tyro.conf.arg(help=text)]


def _word_for(name: str, parts: Sequence[Any]) -> str:
    if Any in parts and str not in parts:
        return "NAME=VALUE" if name != "gates" else "GATE"
    return "INT" if int in parts else "FLOAT" if float in parts else name.split("_")[-1].rstrip("s").upper()


def _value(name: str, words: Sequence[str], kind: Any) -> Any:
    """Return the value of an option from the words on the command line; a setup checks it."""
    parts = set(_parts(kind))
    if bool in parts:
        if len(words) > 1:
            raise ValueError(f"one of true and false is expected, not {' '.join(words)}; no word is true")
        return list(words) != ["false"]
    is_text = not {int, float, Any} & parts
    if any("=" in word for word in words) and {Mapping, Any} & parts:
        pairs = [word.partition("=") for word in words]
        if wrong := [key for key, sign, _ in pairs if not (key and sign)]:
            raise ValueError(f"{wrong[0]!r} is written as name=value, such as lift_height=0.05")
        return {key: _word(text, is_text) for key, _, text in pairs}
    if name == "randomisation" and len(words) > 1:
        raise ValueError(f"one of {', '.join(get_args(Preset))} is expected, not {' '.join(words)}")
    values = [_word(word, is_text) for word in words]
    if not values and name in ("randomisation", "pixels"):
        return True
    is_single = len(values) == 1 and not (tuple in parts and is_text) and name not in ("gates", "layers")
    return values[0] if is_single else values


def _word(word: str, is_text: bool) -> Any:
    if is_text:
        return word
    try:
        return json.loads(word)
    except (ValueError, RecursionError):  # a text need not have quotes
        return None if word.lower() == "none" else word


def _parts(kind: Any) -> list[Any]:
    """Return the types that a type is made of, `tuple` and `Mapping` among them; records have values of any type."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _parts(inner[0])
    if origin in (Union, types.UnionType, tuple):
        return [*(part for one in inner for part in _parts(one)), *((tuple,) if origin is tuple else ())]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return [Mapping, *_parts(inner[1])]
    return [Any if isinstance(kind, type) and issubclass(kind, Record) else kind]


def _texts(record: type[Record]) -> dict[str, str]:
    """Return the docstrings below the fields of a record."""
    body = ast.parse(textwrap.dedent(inspect.getsource(record))).body[0]
    assert isinstance(body, ast.ClassDef)
    return {
        one.target.id: " ".join(str(text.value.value).split())
        for one, text in zip(body.body, body.body[1:], strict=False)
        if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }


def _in_words(value: Any) -> str:
    if isinstance(value, tuple | list | dict) or value is None:
        return " ".join(map(str, value)) if value else "none"
    return str(value).lower() if isinstance(value, bool) else str(value)


if TYPE_CHECKING:
    Flags = Setup
else:
    Flags = flags()


def given(options: Any) -> dict[str, Any]:
    """Return the options that were given, by name."""
    every = {own.name: getattr(options, own.name) for own in dataclasses.fields(options)}
    return {name: value for name, value in every.items() if not isinstance(value, Unset)}


def changed(setup: Setup, options: Mapping[str, Any]) -> Setup:
    """Return a setup with other values of some fields.

    Args:
        setup: The setup.
        options: Values by the names of options: fields of a setup, and of `Cameras` with the names of `OF_CAMERAS`.

    Raises:
        InvalidSetup: A value is invalid.
    """
    fields = {OF_CAMERAS.get(own.name, own.name): own.name for own in dataclasses.fields(Cameras)}  # pyright: ignore[reportArgumentType]
    of_cameras = {fields[name]: value for name, value in options.items() if name in fields}
    if "image_size" in of_cameras:
        of_cameras.setdefault("mode", None)
    elif of_cameras.get("mode") is not None:
        of_cameras["image_size"] = USUAL_SIZE
    if "names" in of_cameras:  # sizes and rates of cameras that are left out go, too
        shown, before = Cameras(names=of_cameras["names"]).names, setup.cameras
        for name in ("image_size", "fps", "mounts"):
            if isinstance(value := getattr(before, name), Mapping) and shown != (ALL,):
                of_cameras.setdefault(name, {camera: own for camera, own in value.items() if camera in shown})
    changes = {name: value for name, value in options.items() if name not in fields}
    if "task_options" in changes:
        changes["task_options"] = {**setup.task_options, **_named(changes["task_options"])}
    return replace(setup, **changes, cameras=replace(setup.cameras, **of_cameras))


def recorded_cameras(hardware: str | None) -> Any:
    """Return the cameras of a recording if none are given: all, and with real arms those of the site's file."""
    if not hardware:
        return ALL
    return tuple(Site.read(hardware).cameras) if hardware.endswith(".json") else ()


def _named(options: Any) -> Mapping[str, Any]:
    if not isinstance(options, Mapping):
        raise InvalidSetup(f"task_options is {options!r}; it is written as name=value, such as lift_height=0.05.")
    return options


@dataclass(kw_only=True)
class SetupOptions:
    """Options of a command that makes an environment in which an agent acts."""

    task: tyro.conf.Positional[str]
    """Name of the task, such as PickCuboid, or `module:Class`; or the path of a checkpoint, or of a run, for the
    environment that it was trained in."""
    agent: str | None = None
    """Name of the agent, `module:Class`, which is called with the environment, the path of a checkpoint, or the address
    of a policy. By default the task's expert, or the policy of the checkpoint that is given in place of the task."""
    seed: int = 0
    """Random seed of the episodes."""
    trust: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[MODULE ...]")] = ()
    """Modules of which the environment of a checkpoint may have classes; importing them runs their code."""
    environment: Annotated[Flags, tyro.conf.OmitArgPrefixes] = field(default_factory=Flags)
    """The fields of `rcs.Setup` and `rcs.Cameras`, as in Python."""

    @property
    def checkpoint(self) -> str | None:
        """Path of the checkpoint, or of the run, whose environment is used; None for one of a task."""
        return next((path for path in (self.task, self.agent) if is_path(path)), None)

    @property
    def actor(self) -> str | None:
        """The agent; None for the expert of the task. For a run, it is the best checkpoint so far."""
        actor = self.checkpoint if self.agent is None else self.agent
        if not is_path(actor):
            return actor
        from rcs.rl.checkpoint import find_checkpoint

        return str(find_checkpoint(str(actor), trust=self.trust).path)

    @property
    def given(self) -> dict[str, Any]:
        """The options of the environment that were given, by name."""
        return given(self.environment)

    def setup(self, stepping: Stepping | None = None, **usual: Any) -> Setup:
        """Return the setup of the options; with a checkpoint, its own, changed by options that are given.

        Args:
            stepping: How steps pass; None for the option.
            usual: Values of options that are not given, without a checkpoint; those of cameras also with one that was
                trained without cameras.

        Raises:
            InvalidSetup: An option makes no sense, or the agent is a checkpoint of another task, or there is none.
            CorruptCheckpoint: The checkpoint is damaged.
            UnknownName: There is no such robot.
        """
        options = self.given if stepping is None else {**self.given, "stepping": stepping}
        if self.checkpoint is None:
            return with_camera_names(changed(Setup(task=self.task), {**usual, **options}))
        from rcs.rl.checkpoint import find_checkpoint

        trained = find_checkpoint(self.checkpoint, trust=self.trust).training.evaluation_setup
        if not trained.cameras:
            options = {**{name: usual[name] for name in usual if name == "cameras"}, **options}
        setup = with_camera_names(changed(trained, options))
        if not is_path(self.task) and setup.task != self.task:
            raise InvalidSetup(f"The checkpoint {self.agent} was trained for {setup.task}, not for {self.task}.")
        return setup
