"""Text becomes HTML in one place, and there it is escaped; no text of a dataset is more than text on any page."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, Feature
from rcs_data.view import write_report, write_view
from rcs_data.view.charts import Series, chart, labels, ticks
from rcs_data.view.html import Html, element, figure, film, header, joined, json_text, page, table

EVIL = "\"'></script></style></title><script>hacked()</script><img src=x onerror=hacked()>&amp;\u2028"
EVIL_ID = "\"'><img src=x onerror=hacked()>&amp;"


class Reader(HTMLParser):
    """Collects what a page has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.handlers: list[str] = []
        self.text: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.words += [value for _, value in attrs if value]

    def handle_data(self, data: str) -> None:
        self.text.append(data)


@pytest.mark.parametrize(
    "made",
    [
        element("p", EVIL, title=EVIL),
        joined([EVIL]),
        table([(EVIL, EVIL)]),
        table([(EVIL,)], (EVIL,)),
        figure(EVIL, EVIL),
        film(EVIL),
        header(EVIL, EVIL, {EVIL: EVIL}),
        page(EVIL, EVIL, assets=Html("")),
        chart(EVIL, [Series(name=EVIL, x=[0, 1], y=[1, 2], told=[EVIL, EVIL])] * 2, most=1),
        f"<script>{json_text({EVIL: EVIL})}</script>",
    ],
)
def test_text_that_is_not_html_is_escaped(made: str) -> None:
    read = Reader(made)
    assert not read.handlers
    assert all("onerror" not in tag for tag in read.tags)
    assert read.tags.count("script") == made.startswith("<script>")
    assert "img" not in read.tags
    assert EVIL in [*read.text, "".join(read.text), *read.words] or "hacked" in "".join([*read.text, *read.words])


def test_html_stays_html_and_nothing_is_left_out_of_values() -> None:
    assert element("b", Html("<i></i>"), None, 0, data_x="1", class_="c", hidden=True, open=False) == (
        '<b data-x="1" class="c" hidden><i></i>0</b>'
    )
    assert element("img", src="a") == '<img src="a">'
    assert json.loads(json_text({"a": EVIL})) == {"a": EVIL}


@pytest.fixture
def evil(tmp_path: Path) -> Path:
    """A dataset in which every text tries to become a part of the page."""
    key = EVIL_ID.replace("/", "")
    features = (
        Feature(key=f"observation/frames/{key}/rgb", shape=(16, 16, 3), dtype="uint8", encoding="jpeg", unit=EVIL),
        Feature(key=f"observation/{key}/joints", shape=(2,), dtype="float64", unit=EVIL),
        Feature(key=f"action/{key}/joints", shape=(2,), dtype="float64", unit=EVIL),
    )
    info = DatasetInfo(
        frequency=30, features=features, setup={EVIL: EVIL, "robot": EVIL, "deep": [{EVIL: EVIL}]}, instruction=EVIL
    )
    path = tmp_path / f"{EVIL_ID}data"
    with DatasetWriter.open(path, info) as writer:
        for number in range(2):
            episode = writer.episode(f"{EVIL_ID}{number}", seed=number, instruction=EVIL * (1 + number))
            for row in range(4):
                values: dict[str, Any] = {features[0].key: np.full((16, 16, 3), row, np.uint8)}
                values[features[1].key] = np.full(2, row / 3)
                episode.add(values | ({features[2].key: np.zeros(2)} if row else {}))
            episode.finish(False, {"failure": EVIL, "aborted": EVIL, EVIL: [{EVIL: EVIL}]})
    return path


def test_no_text_of_a_dataset_is_more_than_text_on_any_page(evil: Path) -> None:
    dataset = Dataset.open(evil)
    pages = {
        "view": (write_view(dataset).path.read_text("utf-8"), 0, 5),
        "report": (write_report(evil).read_text("utf-8"), 0, 9),
    }
    for name, (text, pictures, scripts) in pages.items():
        read = Reader(text)
        assert not read.handlers, name
        assert (read.tags.count("img"), read.tags.count("script")) == (pictures, scripts), name
        if name != "view":
            assert "hacked" in "".join(read.text), "it is told"


def test_what_the_scripts_of_the_view_hold_are_values(evil: Path) -> None:
    folder = write_view(evil).path.parent
    for script in [folder / "dataset.js", *(folder / "episodes").iterdir()]:
        code = script.read_text("ascii")
        assert "<" not in code
        found = re.fullmatch(r"rcs(?:Dataset|Episode)\((.*)\);\n", code, re.DOTALL)
        assert found is not None
        json.loads(found[1])


@pytest.mark.parametrize(
    "change",
    [
        {"success": "yes"}, {"length": 10**18}, {"length": None}, {"outcome": []}, {"outcome": None},
        {"timing": None}, {"timing": {"period": None}}, {"timing": {"period": {"mean": "fast"}}},
        {"timing": {"period": {}}}, {"quality": None},
        {"instruction": None}, {"seed": "7"}, {"seed": -1}, {"started": 7}, {"content_hash": "no"},
        {"versions": None}, {"outcome": {"failure": [1, {"a": None}], "aborted": {"deep": [[[[1]]]]}}},
    ],
)  # fmt: skip
def test_an_episode_that_says_nonsense_is_shown_as_damaged_or_as_what_it_is(
    change: dict[str, Any], dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever of it the reader refuses: no page ends in a traceback, and the other episodes are shown."""
    from rcs_data.files.about import checked_about

    kept: Any = vars(EpisodeRecord)["about"]
    right = kept.func if hasattr(kept, "func") else kept.fget

    def about(self: EpisodeRecord) -> dict[str, Any]:
        values = right(self)
        return checked_about({**values, **change}, Path("data/episode.json")) if self.id == "000001" else values

    monkeypatch.setattr(EpisodeRecord, "about", property(about))
    report = write_view(dataset, options=None)
    assert report.rendered >= 2
    text = (report.path.parent / "dataset.js").read_text("ascii")
    assert report.damaged == ('"damaged":true' in text)
    write_report(dataset)


@pytest.mark.parametrize(
    ("low", "high"), [(99.89, 100.0), (0.0, 100.0), (0.1, 0.1003), (-2e-7, 1e-7), (12_340, 12_360), (0, 3e6)]
)
def test_ticks_have_different_labels_that_say_where_they_are(low: float, high: float) -> None:
    shown = ticks(low, high)
    told = labels(shown)
    assert len(set(told)) == len(told) > 1
    for value, words in zip(shown, told, strict=True):
        number = float(words.replace("\u2212", "-").translate({ord("k"): "e3", ord("M"): "e6", ord("G"): "e9"}))
        assert number == pytest.approx(value, abs=0.26 * (shown[1] - shown[0]))
