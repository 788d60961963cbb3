"""The catalogue of a page: facts of the dataset, and a line for each episode."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime, timezone
from typing import Any

from rcs_data.errors import CorruptEpisode
from rcs_data.files.feature import Feature
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.read.verdicts import Verdicts
from rcs_data.view.clips import pictures
from rcs_data.view.episode_data import FLAWS, curves, is_faster_than_life
from rcs_data.view.html import json_text
from rcs_data.view.rendering import Rendered, clip_name


def catalogue(dataset: Dataset, episodes: Iterable[Rendered], *, wall_time: float | None = None) -> Iterator[bytes]:
    """Yield the script that gives a page all of a dataset but the episodes' data, a line for each episode.

    Args:
        dataset: The dataset.
        episodes: The episodes of the page; they are taken one by one, and none is kept in memory.
        wall_time: How long the collection took [s]; None if it is not known.
    """
    summary = _Summary(dataset)
    yield b'rcsDataset({"episodes":['
    for number, episode in enumerate(episodes):
        yield ((",\n" if number else "\n") + json_text(summary.line(episode))).encode()
    facts = json_text({**_facts(dataset), **summary.figures(wall_time)})
    yield f"\n],{facts.removeprefix('{')});\n".encode()


def _facts(dataset: Dataset) -> dict[str, Any]:
    info = dataset.info
    simple = [
        [key, str(_short(value))] for key, value in info.setup.items() if isinstance(value, str | int | float | bool)
    ]
    return {
        "name": dataset.path.resolve().name,
        "instruction": info.instruction,
        "fps": info.frequency,
        "made": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "isFasterThanLife": is_faster_than_life(info),
        "setup": simple + [[name, version] for name, version in sorted(info.versions.items())],
        "wholeSetup": json.dumps(_short(info.setup), indent=2, ensure_ascii=False),
        "features": [[feature.key, _form(feature)] for feature in info.features],
        "pictures": [
            {
                "label": _label(feature),
                "file": clip_name(feature),
                "unit": feature.unit,
                "aspect": feature.shape[1] / feature.shape[0],
            }
            for feature in pictures(info)
        ],
        "curves": [curve.to_json() for curve in curves(info)],
        "flaws": list(FLAWS),
    }


class _Summary:
    """Counts how the episodes went and how well they were recorded, while their lines are made."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._verdicts: Counter[bool | None] = Counter()
        self._failures: Counter[str] = Counter()
        self._whole = self._rows = self._recovered = self._measured = self._gaps = self._missed = 0
        self._mean = self._wanted = self._jitter = self._longest = 0.0

    def line(self, episode: Rendered) -> dict[str, Any]:
        """Return what the page says of an episode in its list; what is as usual is left out."""
        record = episode.record
        try:
            about = record.about
        except CorruptEpisode:
            return {"id": record.id, "why": episode.why, "damaged": True, "rows": 0, "success": None}
        self._count(record, about)
        outcome = {name: value for name, value in about["outcome"].items() if value is not None}
        facts = {"started": about.get("started"), **outcome, "content": record.content_hash[:16]}
        note = str(outcome.get("failure") or outcome.get("aborted") or "")
        line = {
            "id": record.id,
            "success": record.success,
            "rows": record.length,
            "seed": None if record.seed is None else str(record.seed),  # it may have more digits than a browser keeps
            "facts": [[name, v if isinstance(v, str) else json.dumps(_short(v))] for name, v in facts.items()],
        }
        is_usual = record.instruction == self._dataset.info.instruction
        unusual = {
            "instruction": "" if is_usual else record.instruction,
            "note": note,
            "flaws": episode.flaws,
            "why": episode.why,
        }
        return {**line, **{name: value for name, value in unusual.items() if value}, "damaged": episode.is_damaged}

    def _count(self, record: EpisodeRecord, about: dict[str, Any]) -> None:
        self._whole += 1
        self._verdicts[record.success] += 1
        self._rows += record.length
        self._recovered += bool(about["outcome"].get("recovered"))
        if record.success is False:
            self._failures[str(about["outcome"].get("failure") or "not classified")] += 1
        if period := about["timing"].get("period"):
            self._measured += 1
            self._mean += period["mean"]
            self._wanted = period["expected"]
            self._gaps += period["gaps"]
            self._missed += period["missed_steps"]
            self._jitter = max(self._jitter, period["jitter_p99"])
            self._longest = max(self._longest, period["max"])

    def figures(self, wall_time: float | None) -> dict[str, Any]:
        """Return the counts, the failures by class, and how the recording went."""
        verdicts = Verdicts(succeeded=self._verdicts[True], failed=self._verdicts[False], not_judged=0)
        recording: list[list[str]] = []
        if self._measured:
            mean = self._mean / self._measured
            if is_faster_than_life(self._dataset.info):
                # A simulation that does not wait has no rate to keep: how fast it was is what there is to say.
                times = f", {self._wanted / mean:.1f} times faster than life" if mean > 0 else ""
                recording.append(["computing time per step", f"{1e3 * mean:.2f} ms{times}"])
            else:
                recording.append(["mean period", f"{1e3 * mean:.2f} ms, wanted {1e3 * self._wanted:.2f} ms"])
                recording.append(["jitter, worst episode's p99", f"{1e3 * self._jitter:.2f} ms"])
                recording.append(["gaps", f"{self._gaps}, {self._missed} steps missed"])
            recording.append(["longest step", f"{1e3 * self._longest:.2f} ms"])
        if wall_time:
            recording.append(["episodes per hour", f"{3600 * self._whole / wall_time:.0f}"])
            recording.append(["steps per second", f"{self._rows / wall_time:.0f}"])
        recording.append(["recovered after a crash", str(self._recovered)])
        low, high = verdicts.interval
        counts = {"judged": verdicts.judged, "successes": verdicts.succeeded, "low": low, "high": high}
        failures = [[name, f"{n}, {100 * n / verdicts.judged:.1f} %"] for name, n in self._failures.most_common()]
        return {"counts": {**counts, "rows": self._rows}, "failures": failures, "recording": recording}


def _short(value: Any) -> Any:
    """Return JSON values with six digits at most."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {name: _short(part) for name, part in value.items()}
    return [_short(part) for part in value] if isinstance(value, list | tuple) else value


def _label(feature: Feature) -> str:
    words = [word for word in feature.key.split("/") if word not in ("observation", "frames")]
    return " ".join(words[:-1] if words[-1] == "rgb" else words) or feature.key


def _form(feature: Feature) -> str:
    shape = " \N{MULTIPLICATION SIGN} ".join(map(str, feature.shape)) or "number"
    return " ".join(filter(None, [shape, feature.dtype, feature.unit, feature.encoding.replace("plain", "")]))
