"""The report page: one HTML file beside a dataset that shows how the episodes went, and needs nothing else."""

from __future__ import annotations

import base64
import html
import json
import os
import string
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.data import Dataset, EpisodeRecord
from rcs.data.durable import disk_errors, write_file
from rcs.data.verdicts import Verdicts
from rcs.errors import CorruptEpisode
from rcs.rollout.clip import colour_cameras, encode_clip
from rcs.rollout.plot import line_plot

_TEMPLATE = Path(__file__).with_name("report_template.html")
# Up to here every episode has its clip and plots in the page; above, the first ones and failures have.
_ALL_IN_DETAIL = 200
_FIRST_IN_DETAIL = 100
_MOST_IN_DETAIL = 300


def write_report(dataset_path: str | Path, *, wall_time: float | None = None) -> Path:
    """Write `report.html` into a dataset's folder and return its path; damaged episodes are listed as such.

    Args:
        dataset_path: The folder of the dataset.
        wall_time: How long the collection took [s], for its speed; None leaves that out.

    Raises:
        DatasetError: There is no dataset, or the page cannot be written.
        CorruptEpisode: `dataset.json` is damaged.
    """
    dataset = Dataset.open(dataset_path)
    facts = [_facts(record) for record in dataset.episodes]
    detailed = _in_detail(facts)
    # Decoding and encoding run without Python's lock.
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1), "report") as pool:
        details = dict(zip(detailed, pool.map(lambda i: _detail(facts[i]), detailed), strict=True))
    is_live = not _is_faster_than_life(dataset)
    rows = [_row(episode, details.get(i), is_live=is_live) for i, episode in enumerate(facts)]
    limits = ""
    if len(detailed) < len(facts):
        limits = (
            f"Clips and plots are in this page for {len(detailed)} of {len(facts)} episodes: "
            f"the first {_FIRST_IN_DETAIL}, and failures up to {_MOST_IN_DETAIL} in all."
        )
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    page = string.Template(_TEMPLATE.read_text("utf-8")).substitute(
        title=html.escape(f"Dataset {dataset.path.resolve().name}"),
        instruction=html.escape(dataset.info.instruction),
        subtitle=html.escape(f"{len(facts)} episodes, report of {now}"),
        tiles="".join(_tiles(dataset, facts, wall_time)),
        success=_success(facts),
        failures=_failures(facts),
        quality=_quality(facts, is_live=is_live),
        setup=_setup(dataset),
        episodes="\n".join(rows) or '<p class="note">No episode is complete yet.</p>',
        limits=f'<p class="note">{limits}</p>' if limits else "",
        footer="Robot Control Stack. This file is complete in itself and loads nothing from elsewhere.",
    )
    path = dataset.path / "report.html"
    with disk_errors("write the report", path):
        write_file(path, page.encode())
    return path


@dataclass(frozen=True, kw_only=True)
class _Facts:
    """What `episode.json` says, or that it does not read."""

    record: EpisodeRecord
    damage: str = ""
    about: dict[str, Any] = field(default_factory=dict[str, Any])

    @property
    def success(self) -> bool | None:
        return self.about.get("success")

    @property
    def length(self) -> int:
        return self.about.get("length", 0)

    @property
    def failure(self) -> str | None:
        """The class of the failure; None for an episode that did not fail."""
        if self.success is not False:
            return None
        return str(self.about["outcome"].get("failure") or "not classified")

    @property
    def period(self) -> dict[str, Any]:
        return self.about.get("timing", {}).get("period") or {}

    @property
    def verdict(self) -> str:
        return {True: "success", False: "failure", None: "damaged" if self.damage else "not judged"}[self.success]


def _facts(record: EpisodeRecord) -> _Facts:
    try:
        return _Facts(record=record, about=record.about)
    except CorruptEpisode as err:
        return _Facts(record=record, damage=_without_folder(err, record))


def _without_folder(error: CorruptEpisode, record: EpisodeRecord) -> str:
    # Where the dataset lies on this machine is nothing for a page that is passed on.
    return str(error).replace(f"{record.path}/", "")


def _in_detail(facts: Sequence[_Facts]) -> list[int]:
    if len(facts) <= _ALL_IN_DETAIL:
        return list(range(len(facts)))
    failures = [i for i in range(_FIRST_IN_DETAIL, len(facts)) if facts[i].success is False]
    return [*range(_FIRST_IN_DETAIL), *failures][:_MOST_IN_DETAIL]


def _tiles(dataset: Dataset, facts: Sequence[_Facts], wall_time: float | None) -> Iterable[str]:
    verdicts = _verdicts(facts)
    rows = sum(episode.length for episode in facts)
    yield _tile(f"{len(facts)}", "episodes")
    rate = "\N{EN DASH}" if verdicts.rate is None else f"{100 * verdicts.rate:.1f} %"
    yield _tile(rate, f"success, {verdicts.succeeded} of {verdicts.judged} judged")
    yield _tile(f"{rows:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"), f"rows at {dataset.info.frequency:g} Hz")
    cameras = len(colour_cameras(facts[0].record)) if facts else 0
    yield _tile(str(cameras), "colour camera" if cameras == 1 else "colour cameras")
    size = sum(path.stat().st_size for path in dataset.path.glob("episodes/*/*") if path.is_file())
    yield _tile(f"{size / 1e6:.1f} MB", "on disk")
    if wall_time:
        yield _tile(f"{3600 * len(facts) / wall_time:.0f}", "episodes per hour")
        yield _tile(f"{rows / wall_time:.0f}", "steps per second")


def _tile(value: str, name: str) -> str:
    return f'<div class="tile"><b>{html.escape(value)}</b><span>{html.escape(name)}</span></div>'


def _verdicts(facts: Sequence[_Facts]) -> Verdicts:
    return Verdicts.of(episode.success for episode in facts)


def _success(facts: Sequence[_Facts]) -> str:
    verdicts = _verdicts(facts)
    if verdicts.rate is None:
        return '<p class="note">No episode was judged.</p>'
    (low, high), rate = verdicts.interval, verdicts.rate
    words = (
        f"<b>{verdicts.succeeded} of {verdicts.judged}</b> judged episodes succeeded: {100 * rate:.1f} %, "
        f"95 % interval {100 * low:.1f} to {100 * high:.1f} % (Wilson)."
    )
    others = verdicts.not_judged
    note = f'<p class="note">Not counted, for nobody judged them or they are damaged: {others}.</p>' if others else ""
    return (
        f'{words}<div class="interval"><i style="left:{100 * low:.2f}%;right:{100 - 100 * high:.2f}%"></i>'
        f'<b style="left:{100 * rate:.2f}%"></b></div>'
        f'<div class="scale"><span>0 %</span><span>50 %</span><span>100 %</span></div>{note}'
    )


def _failures(facts: Sequence[_Facts]) -> str:
    classes = Counter(episode.failure for episode in facts if episode.failure is not None)
    if not classes:
        return '<p class="note">No episode failed.</p>'
    most, judged = max(classes.values()), _verdicts(facts).judged
    rows = [
        f"<tr><td>{html.escape(name)}</td><td>{n}</td><td>{100 * n / judged:.1f} %</td>"
        f'<td class="bar"><i style="width:{100 * n / most:.1f}%"></i></td></tr>'
        for name, n in classes.most_common()
    ]
    return f'<table class="bars">{"".join(rows)}</table>'


def _quality(facts: Sequence[_Facts], *, is_live: bool) -> str:
    qualities = [episode.about["timing"] for episode in facts if not episode.damage]
    periods = [episode.period for episode in facts if episode.period]
    cameras = [camera for quality in qualities for camera in (quality.get("cameras") or {}).values()]
    captures = [camera["repeated_captures"] for camera in cameras if camera.get("repeated_captures") is not None]
    rows: list[tuple[str, str]] = []
    mean = float(np.mean([period["mean"] for period in periods])) if periods else 0.0
    if periods and not is_live:
        # A simulation that does not wait has no rate to keep: how fast it was is what there is to say.
        rows += [
            ("Simulated period", f"{1e3 * periods[0]['expected']:.2f} ms, exact"),
            ("Wall time per step", f"{1e3 * mean:.2f} ms{_speed(periods[0]['expected'], mean)}"),
            ("Longest step", f"{1e3 * max(period['max'] for period in periods):.2f} ms"),
        ]
    elif periods:
        rows += [
            ("Mean period", f"{1e3 * mean:.2f} ms (wanted {1e3 * periods[0]['expected']:.2f} ms)"),
            ("Jitter, worst episode's p99", f"{1e3 * max(period['jitter_p99'] for period in periods):.2f} ms"),
            ("Longest period", f"{1e3 * max(period['max'] for period in periods):.2f} ms"),
            ("Gaps", f"{sum(p['gaps'] for p in periods)} ({sum(p['missed_steps'] for p in periods)} steps missed)"),
        ]
    else:
        rows.append(("Period", "not measured"))
    if cameras:
        rows.append(("Images like the one before", str(sum(camera.get("repeated_images") or 0 for camera in cameras))))
        rows.append(("Captures recorded twice", str(sum(captures)) if captures else "not measured"))
    recovered = sum(bool(episode.about["outcome"].get("recovered")) for episode in facts if not episode.damage)
    rows.append(("Recovered after a crash", str(recovered)))
    rows.append(("Damaged", str(sum(bool(episode.damage) for episode in facts))))
    return _table(rows)


def _speed(expected: float, mean: float) -> str:
    """Return how fast a simulation was; a clock that stood still says nothing of that."""
    return f": {expected / mean:.1f} times faster than life" if mean > 0 else ""


def _setup(dataset: Dataset) -> str:
    info = dataset.info
    simple = [(key, str(value)) for key, value in info.setup.items() if isinstance(value, str | int | float | bool)]
    features = [
        (f.key, " ".join([str(list(f.shape)), f.dtype, f.unit, "" if f.encoding == "plain" else f.encoding]))
        for f in info.features
    ]
    whole = html.escape(json.dumps(info.setup, indent=2, ensure_ascii=False))
    versions = sorted(info.versions.items())
    return (
        f"{_table([*simple, *versions])}<details><summary>All of the setup</summary><pre>{whole}</pre></details>"
        f"<details><summary>{len(features)} features</summary>{_table(features)}</details>"
    )


def _table(rows: Iterable[tuple[str, str]]) -> str:
    cells = (f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in rows)
    return f"<table>{''.join(cells)}</table>"


def _row(episode: _Facts, detail: str | None, *, is_live: bool) -> str:
    kind = {"success": "good", "failure": "bad", "damaged": "bad"}.get(episode.verdict, "none")
    seed = "" if episode.about.get("seed") is None else f"seed {episode.about['seed']}"
    period = episode.period["mean" if is_live else "expected"] if episode.period else 0.0
    seconds = f"{period * (episode.length - 1):.1f} s" if period else ""
    why = episode.failure or episode.about.get("outcome", {}).get("aborted") or episode.damage
    cells = (
        f'<span class="badge {kind}">{episode.verdict}</span><span class="id">{html.escape(episode.record.id)}</span>'
        f'<span class="wide dim">{html.escape(seed)}</span><span>{episode.length} rows</span>'
        f'<span class="wide dim">{seconds}</span>'
        f'<span class="wide dim">{html.escape(str(why))}</span>'
    )
    text = html.escape(f"{episode.record.id} {seed} {why} {episode.verdict}".lower())
    verdict = "failure" if episode.verdict == "damaged" else episode.verdict
    data = f'data-verdict="{verdict}" data-text="{text}"'
    if detail is None:
        return f'<div class="episode plain" {data}>{cells}</div>'
    return f'<details class="episode" {data}><summary>{cells}</summary><template>{detail}</template></details>'


def _detail(episode: _Facts) -> str:
    if episode.damage:
        return f'<p class="note">{html.escape(episode.damage)}</p>'
    try:
        return f"{_clip(episode.record)}{''.join(_plots(episode.record))}{_outcome(episode)}"
    except CorruptEpisode as err:
        return f'<p class="note">This episode is damaged: {html.escape(_without_folder(err, episode.record))}</p>'


def _clip(record: EpisodeRecord) -> str:
    clip = encode_clip(record)
    if clip is None:
        return '<p class="note">Recorded without a colour camera, so there is no clip.</p>'
    names = " | ".join(html.escape("/".join(key.split("/")[2:-1])) for key in colour_cameras(record))
    source = base64.b64encode(clip).decode()
    return (
        f'<figure><video controls muted loop playsinline preload="none" src="data:video/mp4;base64,{source}"></video>'
        f"<figcaption>{names}</figcaption></figure>"
    )


def _plots(record: EpisodeRecord) -> Iterable[str]:
    x, x_label = _time(record)
    for feature in record.info.features:
        name = feature.key.removeprefix("observation/")
        if (
            feature.encoding != "plain"
            or name == feature.key
            or name.split("/")[-1] not in ("joints", "gripper", "hand")
        ):
            continue
        lines = record.column(feature.key).reshape(len(x), -1).astype(np.float64)
        unit = f" [{feature.unit}]" if feature.unit else ""
        names = [str(i + 1) for i in range(lines.shape[1])]
        yield line_plot(x, lines, names, x_label=x_label, y_label=f"{name}{unit}")


def _is_faster_than_life(dataset: Dataset) -> bool:
    """Return whether the episodes were simulated without waiting for the wall clock."""
    return dataset.info.sim_state_size is not None and dataset.info.setup.get("mode") == "async"


def _time(record: EpisodeRecord) -> tuple[NDArray[np.float64], str]:
    if any(feature.key == "simulated_time" for feature in record.info.features):
        return record.column("simulated_time"), "simulated time [s]"
    if any(feature.key == "time/monotonic" for feature in record.info.features):
        stamps = record.column("time/monotonic")
        if np.isfinite(stamps).all() and (np.diff(stamps) >= 0).all():
            return stamps - stamps[0], "time [s]"
    return np.arange(record.length, dtype=np.float64), "step"


def _outcome(episode: _Facts) -> str:
    values = {name: value for name, value in episode.about["outcome"].items() if value is not None}
    values |= {"instruction": episode.about["instruction"]}
    values |= {"started": episode.about["started"], "content hash": episode.about["content_hash"][:16]}
    return _table([(name, value if isinstance(value, str) else json.dumps(value)) for name, value in values.items()])
