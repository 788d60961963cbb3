"""A sample of what a policy is fed: some windows as pictures, before and after normalisation, on one page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.durable import disk_errors, write_file
from rcs_data.errors import InvalidSetup
from rcs_data.output import OnProgress
from rcs_data.statistics import Normalisation, Statistics
from rcs_data.view.charts import CHARTS_SCRIPT, Series, chart, short
from rcs_data.view.colours import coloured
from rcs_data.view.html import Html, element, figure, header, page, picture_tag, script, table, web
from rcs_data.windows import Window, Windows

_FAR = 5.0
"""Numbers this many standard deviations from the mean are warned of: of normal ones, 1 in 1.7 million is."""
_ROUNDING = 1e-9
_WIDTH = 340
# Around the pictures of a sheet [px], and its grey.
_GAP, _GREY = 6, 128


@dataclass(frozen=True, kw_only=True)
class SampleReport:
    """What `write_sample` did."""

    path: Path
    """The page."""
    windows: int
    """Windows on it."""
    warnings: tuple[str, ...]
    """What a policy would learn badly from, in words."""


def write_sample(
    windows: Windows,
    out: str | Path,
    *,
    title: str = "What a policy is fed",
    count: int = 8,
    seed: int = 0,
    normalisation: Normalisation = "mean_std",
    floor: float = 0.0,
    png: str | Path | None = None,
    on_progress: OnProgress | None = None,
) -> SampleReport:
    """Draw windows and write one page with what a policy is fed: images, states and actions, with the statistics.

    Args:
        windows: As training has them.
        out: The page to write; an earlier one is replaced.
        title: The page's.
        count: Windows to draw; all if there are fewer.
        seed: Same seed, same windows.
        normalisation: As of `Statistics.normalise`.
        floor: Least spread to divide by, as of `Statistics.normalise`.
        png: Write the images as one picture too: a row per window.
        on_progress: Called with the episodes read for the statistics and all that there are.

    Raises:
        InvalidSetup: The count is below 1, a floor makes no sense, or a number of the dataset is not finite.
        CorruptEpisode: An episode is damaged.
        DatasetError: The page cannot be written.
    """
    if count < 1:
        raise InvalidSetup(f"count is {count}; it must be at least 1.")
    if seed < 0:
        raise InvalidSetup(f"The seed is {seed}; valid is a whole number from 0.")
    chosen = np.random.default_rng(seed).choice(len(windows), min(count, len(windows)), replace=False, shuffle=False)
    drawn = [windows[int(index)] for index in np.sort(chosen)]
    statistics = windows.statistics(on_progress)
    layouts = {"state": windows.state_layout.names, "actions": windows.action_layout.names}
    parts = [_Part(name, layouts[name], statistics[name], normalisation, floor) for name in ("state", "actions")]
    warnings = (*(words for part in parts for words in part.warnings()), *_plain_images(drawn))
    counts = {
        "windows": f"{len(windows):,}".replace(",", "\u202f"),
        "drawn": f"{len(drawn)}, seed {seed}",
        "history": windows.history,
        "horizon": windows.horizon,
        "normalised by": normalisation.replace("_", " ") + (f", at least {floor:g}" if floor else ""),
    }
    notes = [element("li", words, class_="warn") for words in warnings] or [element("li", "Nothing is conspicuous.")]
    tables = [element("div", element("h2", f"Statistics: {p.name}"), p.table(), class_="scroll") for p in parts]
    main = element("main", element("ul", *notes), *(_section(one, parts) for one in drawn), *tables, class_="sheet")
    whole = page(title, header(title, windows.info.instruction, counts), main, script(web(CHARTS_SCRIPT)))
    with disk_errors("write the sample", Path(out)):
        Path(out).parent.mkdir(parents=True, exist_ok=True)
        write_file(Path(out), whole.encode())
        if png is not None:
            Path(png).parent.mkdir(parents=True, exist_ok=True)
            write_file(Path(png), _sheet(drawn))
    return SampleReport(path=Path(out), windows=len(drawn), warnings=warnings)


@dataclass(frozen=True)
class _Part:
    """The state or the actions: names and statistics of their numbers."""

    name: str
    names: tuple[str, ...]
    statistics: Statistics
    by: Normalisation
    floor: float

    def normalised(self, values: NDArray[Any]) -> NDArray[Any]:
        return self.statistics.normalise(values, self.by, floor=self.floor)

    def warnings(self) -> Iterator[str]:
        told = self.statistics
        reach = np.maximum(told.max - told.mean, told.mean - told.min)
        is_constant = told.std <= _ROUNDING * np.maximum(np.abs(told.min), np.abs(told.max))
        for i, name in enumerate(self.names):
            if is_constant[i]:
                yield f"{self.name}: {name} is always {short(told.mean[i])}; normalised, it is 0 and says nothing."
            elif reach[i] > _FAR * told.std[i]:
                far = told.max[i] if told.max[i] - told.mean[i] == reach[i] else told.min[i]
                sigmas = f"{reach[i] / told.std[i]:.1f} \u03c3 from the mean {short(told.mean[i])}"
                yield f"{self.name}: {name} reaches {short(far)}, {sigmas}."

    def table(self) -> Html:
        fields = {"mean": "mean", "std": "\u03c3", "min": "least", "q01": "1 %", "q99": "99 %", "max": "most"}
        columns = [getattr(self.statistics, field) for field in fields]
        rows = [(name, *(short(column[i]) for column in columns)) for i, name in enumerate(self.names)]
        return table(rows, (f"of {self.statistics.count} steps", *fields.values()), class_="figures")

    def over_numbers(self, values: NDArray[Any]) -> Iterator[Html]:
        """Yield charts of vectors (rows, size), before and after normalisation, beside the range of the dataset."""
        told = self.statistics
        x = range(len(self.names))
        for words, change in (("as recorded", np.asarray), ("normalised", self.normalised)):
            mean, low, high = (change(part).tolist() for part in (told.mean, told.min, told.max))
            lines = [Series(name="mean and range", x=x, y=mean, low=low, high=high, colour=7, told=self.told(mean))]
            for back, row in list(enumerate(change(values)[::-1]))[::-1]:
                name = _ago(back) if back else "now"
                lines.append(Series(name=name, x=x, y=row.tolist(), colour=back, is_dotted=True, told=self.told(row)))
            yield chart(f"{self.name}, {words}", lines, most=max(len(x) - 1, 1), width=_WIDTH, word="number")

    def told(self, values: Any) -> list[str]:
        return [f"({name}) {short(value)}" for name, value in zip(self.names, values, strict=True)]

    def over_steps(self, values: NDArray[Any]) -> Iterator[Html]:
        """Yield charts of vectors (steps, size), before and after normalisation."""
        x = range(len(values))
        for words, shown in (("as recorded", values), ("normalised", self.normalised(values))):
            lines = [Series(name=name, x=x, y=shown[:, i].tolist(), colour=i) for i, name in enumerate(self.names)]
            yield chart(f"{self.name}, {words}", lines, most=max(len(x) - 1, 1), width=_WIDTH, word="step")


def _section(window: Window, parts: list[_Part]) -> Html:
    state, actions = parts
    padded, missing = int(window["is_pad"].sum()), int(window["is_history_pad"].sum())
    notes = [f"\u201c{window['instruction']}\u201d"]
    notes += [f"the last {padded} actions repeat the end of the episode"] if padded else []
    notes += [f"the first {missing} observations repeat its start"] if missing else []
    pictures = [
        figure(
            picture_tag(image, height=image.shape[0], title=name),
            element("b", name),
            element("span", f"{image.shape[1]} \u00d7 {image.shape[0]} px", class_="dim"),
        )
        for name, image in _pictures(window)
    ]
    charts = [*state.over_numbers(window["state"]), *actions.over_steps(window["actions"])]
    return element(
        "section",
        element("h2", f"{window['episode']}, step {window['step']}"),
        element("p", "; ".join(notes), class_="dim"),
        element("div", *pictures, class_="films small"),
        element("div", *charts, class_="grid"),
    )


def _pictures(window: Window) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield all images of a window in colour, the newest of each camera first, each with its name."""
    for camera, images in window["images"].items():
        for back, image in enumerate(images[::-1]):
            yield f"{camera}, {_ago(back)}" if back else camera, _in_colour(image)


def _ago(steps: int) -> str:
    return f"{steps} step{'s' * (steps > 1)} before"


def _in_colour(image: NDArray[Any]) -> NDArray[np.uint8]:
    if image.ndim == 3:
        return image
    known = image[image > 0]
    low, high = np.percentile(known, (1, 99)) if known.size else (0.0, 1.0)
    return coloured(image, (float(low), float(max(high, low + 1))))


def _plain_images(drawn: list[Window]) -> Iterator[str]:
    for window in drawn:
        plain = [camera for camera, images in window["images"].items() if any(np.ptp(image) == 0 for image in images)]
        if plain:
            yield f"images: {window['episode']}, step {window['step']}: {', '.join(plain)} shows one colour only."


def _sheet(drawn: list[Window]) -> bytes:
    """Return the images of windows as one PNG file, a row per window."""
    from rcs_data.convert.png import encode_png  # with av, half a tenth of a second to import

    cells = [[image for _, image in _pictures(window)] for window in drawn]
    if not cells[0]:
        raise InvalidSetup("There are no images for a picture; choose cameras, or leave png out.")
    widths = [image.shape[1] + _GAP for image in cells[0]]
    tall = max(image.shape[0] for image in cells[0]) + _GAP
    sheet = np.full((len(cells) * tall + _GAP, sum(widths) + _GAP, 3), _GREY, np.uint8)
    for row, images in enumerate(cells):
        left = _GAP
        for image, width in zip(images, widths, strict=True):
            top = row * tall + _GAP
            sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
            left += width
    return encode_png(sheet)
