"""Makes small datasets, ours and exports of them, and damages them as a hostile or unlucky hand would."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, edit
from rcs_data.convert.formats import EXPORTS
from rcs_data.convert.options import ExportOptions

NATIVE, IMAGES, EDITED, MERGED = "native", "images", "edited", "merged"
LEROBOT_3, LEROBOT_2, ROBOMIMIC = "lerobot-v3", "lerobot-v2.1", "robomimic"
OURS = (NATIVE, IMAGES, EDITED, MERGED)
KINDS = (*OURS, LEROBOT_3, LEROBOT_2, ROBOMIMIC)
HOSTILE: list[Any] = [
    None, True, False, 0, -1, 1, 3, 0.5, -1.5, 10**18, 2**31, 2**63, 10**30, 10**60, 1e308, float("nan"), float("inf"),
    "", "yes", "0", "../../escaped", "../escaped", "/escaped", "..", ".", "a/b", "\udcff", "\0", "[/bold] x",
    "<script>alert(1)</script>", "{0.__class__}", "{episode_index:0999999999d}", "x" * 5000, [], {}, [1], ["x"], [[]],
    {"a": 1}, [10**18], [10**9, 10**9], [0], [-1], [1.5], ["../x"], {"../../escaped": "0" * 64}, {"": {}}, [{}], [None],
]  # fmt: skip


def make_templates(folder: Path) -> None:
    """Make a dataset of each kind."""
    _record(folder / NATIVE, images=False)
    _record(folder / IMAGES, images=True)
    _record(folder / EDITED, images=False)
    edit.relabel(folder / EDITED, "push it")
    edit.trim(folder / EDITED, "000001", first=1)
    edit.merge([folder / NATIVE, folder / EDITED], folder / MERGED)
    options = ExportOptions()
    for kind in (LEROBOT_3, LEROBOT_2, ROBOMIMIC):
        EXPORTS[kind](Dataset.open(folder / IMAGES), folder / kind, options)


def damage(path: Path, kind: str, templates: Path, rng: random.Random) -> list[str]:
    """Damage a copy of a template in some places, and say how."""
    said: list[str] = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        choices: list[Callable[[Path, Path, random.Random], str]] = [_file, _file]
        if kind == ROBOMIMIC:
            choices += [_hdf5] * 3
        else:
            choices += [_json, _json, _json, _json, _folder]
        said.append(rng.choice(choices)(path, templates, rng))
    return said


def _record(path: Path, *, images: bool) -> None:
    features = [
        Feature(key="observation/joints", shape=(7,), dtype="float64", unit="rad"),
        Feature(key="observation/gripper", shape=(1,), dtype="float64"),
        Feature(key="action/joints", shape=(7,), dtype="float64"),
        Feature(key="action/gripper", shape=(1,), dtype="float64"),
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="time/monotonic", shape=(), dtype="float64"),
    ]
    if images:
        features += [
            Feature(key="observation/frames/wrist/rgb", shape=(16, 24, 3), dtype="uint8", encoding="jpeg"),
            Feature(key="observation/frames/side/rgb", shape=(16, 24, 3), dtype="uint8", encoding="lossless"),
            Feature(key="observation/frames/wrist/depth", shape=(8, 10), dtype="uint16", encoding="depth"),
            Feature(key="observation/frames/wrist/intrinsics", shape=(3, 3), dtype="float64", encoding="held"),
            Feature(key="time/frames/wrist", shape=(), dtype="float64"),
            Feature(key="flags/frames/wrist", shape=(), dtype="uint8"),
        ]
    setup = {"robot": "fr3", "task": "PickCuboid", "stepping": "async"}
    info = DatasetInfo(frequency=30, features=tuple(features), setup=setup, instruction="pick", sim_state_size=3)
    rng = np.random.default_rng(0)
    with DatasetWriter.open(path, info) as writer:
        for number in range(3):
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for i in range(4 + number):
                    row: dict[str, Any] = {"observation/joints": rng.normal(size=7), "observation/gripper": np.ones(1)}
                    row |= {"terminated": False, "time/monotonic": i / 30}
                    if i:
                        row |= {"action/joints": rng.normal(size=7), "action/gripper": np.ones(1), "reward": 1.0}
                    if images:
                        row["observation/frames/wrist/rgb"] = rng.integers(0, 255, (16, 24, 3), np.uint8)
                        row["observation/frames/side/rgb"] = rng.integers(0, 255, (16, 24, 3), np.uint8)
                        row["observation/frames/wrist/depth"] = rng.integers(0, 255, (8, 10), np.uint16)
                        row["observation/frames/wrist/intrinsics"] = np.eye(3)
                        row["time/frames/wrist"] = i / 30
                    episode.add(row, rng.normal(size=3))
                episode.finish((True, False, None)[number], {"failure": None})


def _files(path: Path, pattern: str = "*") -> list[Path]:
    if path.is_file() or path.is_symlink():
        return [path]
    return sorted(file for file in path.rglob(pattern) if file.is_file() and not file.is_symlink())


def _json(path: Path, templates: Path, rng: random.Random) -> str:
    """Change values of a description, and give it the checksum that goes with them."""
    files = [file for file in _files(path) if file.suffix in (".json", ".jsonl")]
    if not files:
        return "no description"
    file = rng.choice(files)
    lines = (
        file.read_text(errors="replace").split("\n") if file.suffix == ".jsonl" else [file.read_text(errors="replace")]
    )
    number = rng.randrange(len(lines))
    is_line = file.name == "episodes.jsonl" or file.parent.name == "history"
    try:
        values = json.loads(lines[number])
    except ValueError:
        return f"{file.name} is damaged already"
    how = _mutate(values, rng)
    if is_line and isinstance(values, dict):
        text = json.dumps({key: value for key, value in values.items() if key != "checksum"}, separators=(",", ":"))[
            :-1
        ]
        text = f'{text},"checksum":"{zlib.crc32(text.encode()):08x}"}}'
    else:
        text = json.dumps(_sealed(values) if isinstance(values, dict) and "checksum" in values else values)
    lines[number] = text
    _replace(file, "\n".join(lines).encode())
    return f"{file.name}: {how}"


def _sealed(values: dict[str, Any]) -> dict[str, Any]:
    given = {key: value for key, value in values.items() if key != "checksum"}
    canonical = json.dumps(given, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return {**given, "checksum": hashlib.sha256(canonical.encode()).hexdigest()}


def _mutate(values: Any, rng: random.Random) -> str:
    places: list[tuple[Any, Any, str]] = []

    def walk(value: Any, name: str) -> None:
        items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, inner in list(items):
            if key != "checksum":
                places.append((value, key, f"{name}.{key}"))
                walk(inner, f"{name}.{key}")

    walk(values, "")
    if not places:
        return "nothing to change"
    # Half of the time at the top, where each field has a meaning of its own.
    top = [place for place in places if place[0] is values]
    owner, key, name = rng.choice(top if rng.random() < 0.5 and top else places)
    value = rng.choice(HOSTILE)
    what = rng.random()
    if what < 0.1:
        del owner[key]
        return f"{name} gone"
    if what < 0.2 and isinstance(owner, dict):
        owner[str(value)[:300]] = owner.pop(key)
        return f"{name} renamed to {str(value)[:30]!r}"
    owner[key] = value
    return f"{name} = {str(value)[:40]!r}"


def _file(path: Path, templates: Path, rng: random.Random) -> str:
    """Cut, scribble over, swap or replace a file."""
    files = _files(path)
    if not files:
        return "no file"
    file = rng.choice(files)
    how = rng.choice(
        ("cut", "bits", "bits", "empty", "gone", "swap", "folder", "link", "link out", "loop", "pipe", "noise")
    )
    data = file.read_bytes()
    if how == "cut":
        _replace(file, data[: rng.randrange(len(data) + 1)])
    elif how == "bits":
        _replace(file, _flipped(data, rng))
    elif how == "empty":
        _replace(file, b"")
    elif how == "noise":
        _replace(file, rng.randbytes(rng.choice((1, 20, 5000))))
    elif how == "swap":
        _replace(file, rng.choice(files).read_bytes())
    else:
        file.unlink()
        if how == "folder":
            file.mkdir()
        elif how == "link":
            file.symlink_to(rng.choice(files).absolute())
        elif how == "link out":
            file.symlink_to((path.parent / "outside" / rng.choice(("file", "folder", "nothing"))).absolute())
        elif how == "loop":
            file.symlink_to(file.absolute())
        elif how == "pipe":
            os.mkfifo(file)
    return f"{file.relative_to(path) if file != path else file.name}: {how}"


def _folder(path: Path, templates: Path, rng: random.Random) -> str:
    """Replace a folder, or put something beside the others that nobody expects."""
    folders = sorted(folder for folder in path.rglob("*") if folder.is_dir() and not folder.is_symlink())
    if not folders:
        return "no folder"
    folder = rng.choice(folders)
    how = rng.choice(("gone", "file", "link out", "open link", "stranger", "lock link", "tmp link", "page link"))
    outside = (path.parent / "outside" / "folder").absolute()
    if how in ("gone", "file", "link out"):
        shutil.rmtree(folder)
        if how == "file":
            folder.write_bytes(b"x")
        elif how == "link out":
            folder.symlink_to(outside)
    else:
        place, target = {
            "open link": (path / "open" / "x", outside),
            "stranger": (path / "episodes" / os.fsdecode(b"\xff\n"), outside),
            "lock link": (path / ".writer.lock", outside / "file"),
            "tmp link": (path / "dataset.json.tmp", outside / "file"),
            "page link": (path / "view", outside),
        }[how]
        if place.parent.is_dir() and not place.parent.is_symlink():
            if os.path.lexists(place):
                place.unlink()
            place.symlink_to(target)
    return f"{folder.relative_to(path)}: {how}"


def _hdf5(path: Path, templates: Path, rng: random.Random) -> str:
    import h5py

    try:
        file: Any = h5py.File(path, "r+")
    except OSError:
        return "the HDF5 file is damaged already"
    with file:
        names: list[str] = []
        try:
            file.visit(names.append)
        except (RuntimeError, OSError, KeyError):
            return "the HDF5 file is damaged already"
        if not names:
            return "nothing in it"
        name = rng.choice(names)
        how = rng.choice(("gone", "group", "text", "attributes", "shape", "big", "link"))
        if how == "attributes":
            owner = file[rng.choice(["data", name])] if "data" in file else file[name]
            keys = list(owner.attrs)
            if keys:
                key = rng.choice(keys)
                text = str(owner.attrs[key])
                try:
                    values = json.loads(text)
                    said = _mutate(values, rng) if isinstance(values, dict | list) else "replaced"
                    owner.attrs[key] = json.dumps(values) if said != "replaced" else "../../escaped"
                except ValueError:
                    owner.attrs[key] = text[: len(text) // 2]
            return f"{name}: attributes"
        shape = getattr(file[name], "shape", None)
        del file[name]
        if how == "group":
            file.create_group(name)
        elif how == "text":
            file[name] = "words"
        elif how == "shape":
            file[name] = np.zeros((3, 1, 2))
        elif how == "big":
            # Chunks that were never written take no space.
            rows = (shape or (5,))[0] if rng.random() < 0.5 else 10**9
            file.create_dataset(name, (rows, 30_000, 30_000), "float64", chunks=(1, 100, 100))
        elif how == "link":
            file[name] = h5py.ExternalLink(str(path.parent / "outside" / "file"), "data")
        return f"{name}: {how}"


def _flipped(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 30))):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _replace(file: Path, data: bytes) -> None:
    """Write a file anew: what is there may be one of several names of it."""
    if os.path.lexists(file):
        shutil.rmtree(file) if file.is_dir() and not file.is_symlink() else file.unlink()
    file.write_bytes(data)
