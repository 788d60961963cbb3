"""The report of a run: one page that needs nothing else, with curves, videos and what was trained."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rcs_data.durable import disk_errors, write_file
from rcs_data.verdicts import wilson_interval
from rcs_data.view.page import WEB as SHARED

from rcs.errors import CorruptCheckpoint
from rcs.rl.charts import Series, chart
from rcs.rl.checkpoint import Checkpoint, best_of, checkpoints_of, open_checkpoint
from rcs.rl.examiner import VIDEOS
from rcs.rl.metrics import EPISODES, JUDGED, LENGTH, RATE, REWARD, SPEED, SUCCESSES, Row, read_metrics
from rcs.rl.run import read_training
from rcs.rl.training import Training

REPORT = "report.html"
_WEB = Path(__file__).with_name("web")
_MOST_VIDEOS = 6
_TRAINING = {
    "rollout/ep_rew_mean": "Return of training's last 100 episodes, exploring",
    "rollout/ep_len_mean": "Steps of training's last 100 episodes",
    "train/value_loss": "Loss of the value",
    "train/policy_gradient_loss": "Loss of the policy",
    "train/critic_loss": "Loss of the critics",
    "train/actor_loss": "Loss of the actor",
    "train/ent_coef": "Weight of the entropy",
    "train/std": "Standard deviation of the actions",
    "train/approx_kl": "Kullback-Leibler divergence of an update",
    "train/clip_fraction": "Share of clipped ratios",
    "train/explained_variance": "Explained variance of the value",
    "train/learning_rate": "Step size",
    SPEED: "Steps per second while learning",
}


def write_report(run: str | Path) -> Path:
    """Write `report.html` into a run's folder and return its path.

    Raises:
        InvalidSetup: There is no run.
        DatasetError: The page cannot be written.
    """
    folder = Path(run)
    training = read_training(folder)
    rows = read_metrics(folder)
    checkpoints: list[Checkpoint] = []
    for place in checkpoints_of(folder):
        try:
            checkpoints.append(open_checkpoint(place))
        except CorruptCheckpoint:
            continue
    path = folder / REPORT
    with disk_errors("write the report", path):
        write_file(path, _page(folder, training, rows, checkpoints).encode())
    return path


def _page(folder: Path, training: Training, rows: Sequence[Row], checkpoints: Sequence[Checkpoint]) -> str:
    setup = training.setup
    title = f"{setup.task} on {setup.robot}"
    best = best_of(list(checkpoints))
    parts = [_success(rows, training), _videos(folder, checkpoints, best), _curves(rows, training)]
    parts.append(_tables(training, checkpoints))
    style = (SHARED / "viewer.css").read_text("utf-8") + (_WEB / "training.css").read_text("utf-8")
    script = (_WEB / "training.js").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>\n{style}</style></head><body>"
        f"{_header(title, training, rows, best)}"
        f'<main class="training">{"".join(parts)}</main><script>\n{script}</script></body></html>\n'
    )


def _header(title: str, training: Training, rows: Sequence[Row], best: Checkpoint | None) -> str:
    facts: list[tuple[str, str]] = []
    if best is not None and best.score is not None and best.score.judged:
        score = best.score
        low, high = (100 * bound for bound in wilson_interval(score.successes, score.judged))
        rate = f"{100 * score.successes / score.judged:.0f} % ({low:.0f} to {high:.0f})"
        facts.append((f"best checkpoint, {score.successes} of {score.judged}", rate))
    if rows:
        facts.append((f"of {_grouped(training.steps)} steps", _grouped(rows[-1].steps)))
        facts.append(("wall time", _time(rows[-1].seconds)))
    speeds = [row.figures[SPEED] for row in rows if SPEED in row.figures]
    if speeds:
        facts.append(("steps/s, learning", f"{speeds[-1]:.0f}"))
    counts = "".join(f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd></div>" for name, value in facts)
    sees = f"sees {', '.join(training.setup.cameras)}" if training.setup.cameras else "is told the state"
    what = f"{training.algorithm.name.upper()}, {training.copies} copies, seed {training.seed}; the policy {sees}"
    return (
        f'<header><div class="title"><h1>{html.escape(title)}</h1><p id="instruction">{html.escape(what)}</p></div>'
        f'<dl id="counts">{counts}</dl></header>'
    )


def _success(rows: Sequence[Row], training: Training) -> str:
    judged = [row for row in rows if RATE in row.figures]
    if not judged:
        return "<p>No evaluation was judged.</p>"
    bounds = [wilson_interval(int(row.figures[SUCCESSES]), int(row.figures[JUDGED])) for row in judged]
    evaluated = Series(
        name="evaluation",
        x=[row.steps for row in judged],
        y=[100 * row.figures[RATE] for row in judged],
        low=[100 * low for low, _ in bounds],
        high=[100 * high for _, high in bounds],
        told=[
            f"{row.figures[SUCCESSES]:.0f} of {row.figures[JUDGED]:.0f} ({100 * low:.0f} to {100 * high:.0f} %), after "
            f"{_time(row.seconds)}"
            for row, (low, high) in zip(judged, bounds, strict=True)
        ],
    )
    title = f"Success [%] in {judged[-1].figures[EPISODES]:.0f} episodes that training never sees, 95 % Wilson interval"
    lines = [evaluated]
    if explored := _series(rows, "rollout/success_rate", "exploring, last 100 episodes of training"):
        percent = [100 * y for y in explored.y]
        told = [f"{y:.0f} %" for y in percent]
        lines.append(replace(explored, y=percent, told=told, colour=1))
    most = _most(rows, training)
    return f'<section class="wide">{chart(title, lines, most=most, span=(0, 100), width=1000)}</section>'


def _videos(folder: Path, checkpoints: Sequence[Checkpoint], best: Checkpoint | None) -> str:
    filmed = [one for one in checkpoints if (folder / VIDEOS / f"{one.steps:09d}.mp4").exists()]
    if not filmed:
        return ""
    count = min(_MOST_VIDEOS, len(filmed))
    chosen = {round(i * (len(filmed) - 1) / max(count - 1, 1)) for i in range(count)}
    shown = [one for i, one in enumerate(filmed) if i in chosen or (best is not None and one.steps == best.steps)]
    parts: list[str] = []
    for one in shown:
        data = base64.b64encode((folder / VIDEOS / f"{one.steps:09d}.mp4").read_bytes()).decode("ascii")
        score = "" if one.score is None else f"{one.score.successes} of {one.score.judged} succeed"
        badge = '<span class="badge success">best</span>' if best is not None and one.steps == best.steps else ""
        parts.append(
            f'<figure><video controls muted loop playsinline preload="metadata" src="data:video/mp4;base64,{data}">'
            f'</video><figcaption><b>step {_grouped(one.steps)}</b><span class="dim">{html.escape(score)}</span>{badge}'
            "</figcaption></figure>"
        )
    return f'<section><h2>The same episode at different steps</h2><div class="films">{"".join(parts)}</div></section>'


def _curves(rows: Sequence[Row], training: Training) -> str:
    names = {REWARD: "Return of evaluated episodes", LENGTH: "Steps of evaluated episodes", **_TRAINING}
    most = _most(rows, training)
    charts = [
        chart(title, [series], most=most) for name, title in names.items() if (series := _series(rows, name, title))
    ]
    return f'<section><h2>Curves over steps</h2><div class="grid">{"".join(charts)}</div></section>' if charts else ""


def _series(rows: Sequence[Row], name: str, title: str) -> Series | None:
    points = [(row.steps, row.figures[name]) for row in rows if name in row.figures]
    if not points:
        return None
    return Series(name=title, x=[x for x, _ in points], y=[y for _, y in points])


def _most(rows: Sequence[Row], training: Training) -> int:
    return max(training.steps, *(row.steps for row in rows), 1)


def _tables(training: Training, checkpoints: Sequence[Checkpoint]) -> str:
    own = training.to_json()
    setup, algorithm = own.pop("setup"), own.pop("algorithm")
    tables = {"Training": own, f"Algorithm: {algorithm.pop('name')}": algorithm}
    of_cameras = () if setup["cameras"] else ("image_size", "render_quality", "assets")
    tables["Environment"] = {
        name: value for name, value in setup.items() if value not in (None, [], {}, False) and name not in of_cameras
    }
    if checkpoints:
        tables["Software"] = dict(checkpoints[-1].versions)
    parts = [f"<div><h2>{html.escape(name)}</h2>{_table(values)}</div>" for name, values in tables.items()]
    return f'<section><h2>What was trained</h2><div class="tables">{"".join(parts)}</div></section>'


def _table(values: Mapping[str, Any]) -> str:
    return (
        "<table>"
        + "".join(
            f"<tr><th>{html.escape(name)}</th><td>{html.escape(_words(value))}</td></tr>"
            for name, value in values.items()
        )
        + "</table>"
    )


def _words(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(map(_words, value)) or "none"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_words(own)}" for name, own in value.items()) or "none"
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)


def _grouped(number: int) -> str:
    return f"{number:,}".replace(",", "\u202f")


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"
