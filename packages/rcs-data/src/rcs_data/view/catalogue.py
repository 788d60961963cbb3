"""What the page knows of a dataset before an episode is opened: its facts, and a line for each episode."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any

from rcs_data.diversity import diversity_of_ways, ways_of
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import Feature
from rcs_data.info import DatasetInfo
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.verdicts import Verdicts
from rcs_data.view.clips import pictures
from rcs_data.view.episode_data import FLAWS, curves, is_faster_than_life

Entry = tuple[EpisodeRecord, dict[str, int], str]
"""An episode, how many steps each of its flaws has, and why the page does not show it."""

DAMAGED = "is damaged: "
"""How the reason begins for an episode that does not read."""


def catalogue(
    dataset: Dataset,
    entries: Sequence[Entry],
    clips: Sequence[str],
    *,
    wall_time: float | None = None,
    scripted: float | None = None,
) -> dict[str, Any]:
    """Return the facts of a dataset as JSON values.

    Args:
        dataset: The dataset.
        entries: The episodes of the page.
        clips: The file names of the clips, one for each of `pictures`.
        wall_time: How long the collection took [s]; None if it is not known.
        scripted: By how much the ways of the task's scripted expert differ [rad]; None if it is not known.
    """
    info = dataset.info
    simple = [
        [key, str(_short(value))] for key, value in info.setup.items() if isinstance(value, str | int | float | bool)
    ]
    whole = [record for record, _, _ in entries if _about(record)]
    shown = zip(pictures(info), clips, strict=True)
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
                "file": name,
                "unit": feature.unit,
                "aspect": feature.shape[1] / feature.shape[0],
            }
            for feature, name in shown
        ],
        "curves": [curve.to_json() for curve in curves(info)],
        "flaws": list(FLAWS),
        **_summary(dataset, whole, wall_time),
        "diversity": _diversity(info, whole, scripted),
        "episodes": [_episode(*entry) for entry in entries],
    }


def _about(record: EpisodeRecord) -> dict[str, Any]:
    try:
        return record.about
    except CorruptEpisode:
        return {}


def _summary(dataset: Dataset, whole: Sequence[EpisodeRecord], wall_time: float | None) -> dict[str, Any]:
    """Return how the episodes went, and how well they were recorded."""
    verdicts = Verdicts.of(record.success for record in whole)
    low, high = verdicts.interval
    rows = sum(record.length for record in whole)
    failed = Counter(str(r.outcome.get("failure") or "not classified") for r in whole if r.success is False)
    periods = [period for record in whole if (period := record.timing.get("period"))]
    recording: list[list[str]] = []
    if periods:
        mean = sum(period["mean"] for period in periods) / len(periods)
        longest = max(period["max"] for period in periods)
        wanted = periods[0]["expected"]
        if is_faster_than_life(dataset.info):
            # A simulation that does not wait has no rate to keep: how fast it was is what there is to say.
            times = f", {wanted / mean:.1f} times faster than life" if mean > 0 else ""
            recording.append(["computing time per step", f"{1e3 * mean:.2f} ms{times}"])
        else:
            jitter = max(period["jitter_p99"] for period in periods)
            gaps, missed = sum(p["gaps"] for p in periods), sum(p["missed_steps"] for p in periods)
            recording.append(["mean period", f"{1e3 * mean:.2f} ms, wanted {1e3 * wanted:.2f} ms"])
            recording.append(["jitter, worst episode's p99", f"{1e3 * jitter:.2f} ms"])
            recording.append(["gaps", f"{gaps}, {missed} steps missed"])
        recording.append(["longest step", f"{1e3 * longest:.2f} ms"])
    if wall_time:
        recording.append(["episodes per hour", f"{3600 * len(whole) / wall_time:.0f}"])
        recording.append(["steps per second", f"{rows / wall_time:.0f}"])
    recording.append(["recovered after a crash", str(sum(bool(r.outcome.get("recovered")) for r in whole))])
    counts = {"judged": verdicts.judged, "successes": verdicts.succeeded, "low": low, "high": high, "rows": rows}
    failures = [[name, f"{n}, {100 * n / verdicts.judged:.1f} %"] for name, n in failed.most_common()]
    return {"counts": counts, "failures": failures, "recording": recording}


def _diversity(info: DatasetInfo, whole: Sequence[EpisodeRecord], scripted: float | None) -> dict[str, Any] | None:
    """Return by how much ways differ [rad], of these episodes and of the scripted expert; None if nobody can say."""
    ways = ways_of(info, whole)
    if len(ways) < 2:
        return None
    return {"ways": _short(diversity_of_ways(ways)), "scripted": _short(scripted), "episodes": len(ways)}


def _episode(record: EpisodeRecord, flaws: dict[str, int], why: str) -> dict[str, Any]:
    if not _about(record):
        empty = {"success": None, "rows": 0, "note": why, "instruction": "", "facts": [], "flaws": {}}
        return {"id": record.id, "why": why, "damaged": True, **empty}
    outcome = {name: value for name, value in record.outcome.items() if value is not None}
    note = outcome.get("failure") or outcome.get("aborted") or ""
    facts = {"started": record.about.get("started"), **outcome, "content": record.content_hash[:16]}
    return {
        "id": record.id,
        "success": record.success,
        "rows": record.length,
        "seed": None if record.seed is None else str(record.seed),  # it may have more digits than a browser keeps
        "instruction": record.instruction,
        "note": str(note),
        "facts": [[name, v if isinstance(v, str) else json.dumps(_short(v))] for name, v in facts.items()],
        "flaws": flaws,
        "why": why,
        "damaged": why.startswith(DAMAGED),
    }


def _short(value: Any) -> Any:
    """Return JSON values with no more digits than anybody reads."""
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
