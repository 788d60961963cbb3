"""The report of a run: one page that needs nothing else, with curves, videos and what was trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rcs_data.files.durable import disk_errors, write_file
from rcs_data.read.verdicts import wilson_interval
from rcs_data.view.charts import CHARTS_SCRIPT, Series, chart
from rcs_data.view.html import Html, element, figure, film, header, page, script, table, web

from rcs.rl.checkpoint import VIDEOS, Checkpoint, best_of, read_training, whole_checkpoints
from rcs.rl.metrics import EPISODES, JUDGED, LENGTH, RATE, REWARD, SPEED, SUCCESSES, Row, read_metrics
from rcs.rl.training import Training

REPORT = "report.html"
_MOST_VIDEOS = 6
_TRAINING = {
    "rollout/ep_rew_mean": "Return of training's last 100 episodes, exploring",
    "rollout/ep_len_mean": "Steps of training's last 100 episodes",
    "train/value_loss": "Loss of the value",
    "train/policy_gradient_loss": "Loss of the policy",
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
        CorruptCheckpoint: All checkpoints are damaged.
        DatasetError: The page cannot be written.
    """
    folder = Path(run)
    text = _page(folder, read_training(folder), read_metrics(folder), whole_checkpoints(folder))
    path = folder / REPORT
    with disk_errors("write the report", path):
        write_file(path, text.encode())
    return path


def _page(folder: Path, training: Training, rows: Sequence[Row], checkpoints: Sequence[Checkpoint]) -> str:
    setup = training.setup
    title = f"{setup.task} on {setup.robot_label}"
    best = best_of(checkpoints)
    parts = [_success(rows, training), _videos(folder, checkpoints, best), _curves(rows, training)]
    main = element("main", *parts, _tables(training, checkpoints), class_="sheet")
    return page(title, _header(title, training, rows, best), main, script(web(CHARTS_SCRIPT)))


def _header(title: str, training: Training, rows: Sequence[Row], best: Checkpoint | None) -> Html:
    facts: dict[str, str] = {}
    if best is not None and best.score is not None and best.score.judged:
        score = best.score
        low, high = (100 * bound for bound in wilson_interval(score.successes, score.judged))
        rate = f"{100 * score.successes / score.judged:.0f} % ({low:.0f} to {high:.0f})"
        facts[f"best checkpoint, {score.successes} of {score.judged}"] = rate
    if rows:
        facts[f"of {_grouped(training.steps)} steps"] = _grouped(rows[-1].steps)
        facts["wall time"] = _time(rows[-1].seconds)
    speeds = [row.figures[SPEED] for row in rows if SPEED in row.figures]
    if speeds:
        facts["steps/s, learning"] = f"{speeds[-1]:.0f}"
    sees = f"sees {', '.join(training.setup.cameras.names)}" if training.setup.cameras else "observes the state"
    what = f"{training.algorithm.name.upper()}, {training.copies} copies, seed {training.seed}; the policy {sees}"
    return header(title, what, facts)


def _success(rows: Sequence[Row], training: Training) -> Html:
    judged = [row for row in rows if RATE in row.figures]
    if not judged:
        return element("p", "No evaluation was judged.")
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
        labels = [f"{y:.0f} %" for y in percent]
        lines.append(replace(explored, y=percent, told=labels, colour=1))
    most = _most(rows, training)
    # One for screens, one for phones, on which the first would be as flat as it is wide.
    drawn = (chart(title, lines, most=most, span=(0, 100), width=width) for width in (1000, 460))
    wide, narrow = (element("div", one, class_=name) for one, name in zip(drawn, ("wide", "narrow"), strict=True))
    return element("section", wide, narrow)


def _videos(folder: Path, checkpoints: Sequence[Checkpoint], best: Checkpoint | None) -> Html | None:
    filmed = [one for one in checkpoints if (folder / VIDEOS / f"{one.steps:09d}.mp4").exists()]
    if not filmed:
        return None
    count = min(_MOST_VIDEOS, len(filmed))
    chosen = {round(i * (len(filmed) - 1) / max(count - 1, 1)) for i in range(count)}
    shown = [one for i, one in enumerate(filmed) if i in chosen or (best is not None and one.steps == best.steps)]
    figures: list[Html] = []
    for one in shown:
        score = "" if one.score is None else f"{one.score.successes} of {one.score.judged} succeed"
        is_best = best is not None and one.steps == best.steps
        caption = [element("b", f"step {_grouped(one.steps)}"), element("span", score, class_="dim")]
        caption += [element("span", "best", class_="badge success")] if is_best else []
        figures.append(figure(film((folder / VIDEOS / f"{one.steps:09d}.mp4").read_bytes()), *caption))
    title = element("h2", "The same episode at different steps")
    return element("section", title, element("div", *figures, class_="films"))


def _curves(rows: Sequence[Row], training: Training) -> Html | None:
    names = {REWARD: "Return of evaluated episodes", LENGTH: "Steps of evaluated episodes", **_TRAINING}
    most = _most(rows, training)
    charts = [
        chart(title, [series], most=most) for name, title in names.items() if (series := _series(rows, name, title))
    ]
    title = element("h2", "Curves over steps")
    return element("section", title, element("div", *charts, class_="grid")) if charts else None


def _series(rows: Sequence[Row], name: str, title: str) -> Series | None:
    points = [(row.steps, row.figures[name]) for row in rows if name in row.figures]
    if not points:
        return None
    return Series(name=title, x=[x for x, _ in points], y=[y for _, y in points])


def _most(rows: Sequence[Row], training: Training) -> int:
    return max(training.steps, *(row.steps for row in rows), 1)


def _tables(training: Training, checkpoints: Sequence[Checkpoint]) -> Html:
    own = training.to_json()
    setup, algorithm = own.pop("setup"), own.pop("algorithm")
    tables = {"Training": own, f"Algorithm: {algorithm.pop('name')}": algorithm}
    cameras = setup.pop("cameras")
    setup |= {"cameras": cameras.pop("names"), **cameras} if cameras["names"] else {}
    of_cameras = () if setup.get("cameras") else ("render_quality", "assets")
    tables["Environment"] = {
        name: value for name, value in setup.items() if value not in (None, [], {}, False) and name not in of_cameras
    }
    if checkpoints:
        tables["Software"] = dict(checkpoints[-1].versions)
    parts = [
        element("div", element("h2", name), table((key, _words(value)) for key, value in values.items()))
        for name, values in tables.items()
    ]
    return element("section", element("h2", "Training"), element("div", *parts, class_="tables"))


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
