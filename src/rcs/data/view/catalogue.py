"""What the page knows of a dataset before an episode is opened: its facts, and a line for each episode."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from rcs.data.feature import Feature
from rcs.data.reader import Dataset, EpisodeRecord
from rcs.data.verdicts import Verdicts
from rcs.data.view.clips import pictures
from rcs.data.view.episode_data import FLAWS, curves, is_faster_than_life

Entry = tuple[EpisodeRecord, dict[str, int], str]
"""An episode, how many rows each of its flaws has, and why it does not read."""


def catalogue(dataset: Dataset, entries: Sequence[Entry], clips: Sequence[str]) -> dict[str, Any]:
    """Return the facts of a dataset as JSON values.

    Args:
        dataset: The dataset.
        entries: The episodes of the page.
        clips: The file names of the clips, one for each of `pictures`.
    """
    info = dataset.info
    simple = [[key, str(value)] for key, value in info.setup.items() if isinstance(value, str | int | float | bool)]
    shown = zip(pictures(info), clips, strict=True)
    return {
        "name": dataset.path.resolve().name,
        "instruction": info.instruction,
        "fps": info.frequency,
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "isFasterThanLife": is_faster_than_life(info),
        "setup": simple + [[name, version] for name, version in sorted(info.versions.items())],
        "wholeSetup": json.dumps(info.setup, indent=2, ensure_ascii=False),
        "features": [[feature.key, _form(feature)] for feature in info.features],
        "pictures": [{"label": _label(feature), "file": name, "unit": feature.unit} for feature, name in shown],
        "curves": [curve.to_json() for curve in curves(info)],
        "flaws": list(FLAWS),
        "counts": _counts(entries),
        "episodes": [_episode(*entry) for entry in entries],
    }


def _counts(entries: Sequence[Entry]) -> dict[str, Any]:
    whole = [record for record, _, damage in entries if not damage]
    verdicts = Verdicts.of(record.success for record in whole)
    low, high = verdicts.interval
    rows = sum(record.length for record in whole)
    return {"judged": verdicts.judged, "successes": verdicts.succeeded, "low": low, "high": high, "rows": rows}


def _episode(record: EpisodeRecord, flaws: dict[str, int], damage: str) -> dict[str, Any]:
    if damage:
        return {"id": record.id, "success": None, "rows": 0, "note": damage, "facts": [], "flaws": {}, "damaged": True}
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
        "facts": [[name, value if isinstance(value, str) else json.dumps(value)] for name, value in facts.items()],
        "flaws": flaws,
    }


def _label(feature: Feature) -> str:
    words = [word for word in feature.key.split("/") if word not in ("observation", "frames")]
    return " ".join(words[:-1] if words[-1] == "rgb" else words) or feature.key


def _form(feature: Feature) -> str:
    shape = " \N{MULTIPLICATION SIGN} ".join(map(str, feature.shape)) or "number"
    return " ".join(filter(None, [shape, feature.dtype, feature.unit, feature.encoding.replace("plain", "")]))
