"""The page in a browser: it plays, stays in step, seeks to the very frame, filters, compares, and is not fooled."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import quote

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.view import ClipOptions, write_report, write_view

pytestmark = pytest.mark.browser

VIDEOS = "[...document.querySelectorAll('video')]"
SETTLED = f"document.body.dataset.episode !== undefined && {VIDEOS}.every((v) => v.readyState >= 2 && !v.seeking)"
# The brightness in the middle of each video, by the number of its picture.
BRIGHTNESS = f"""{VIDEOS}.map((video) => {{
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
  const pen = canvas.getContext("2d");
  pen.drawImage(video, 0, 0);
  const data = pen.getImageData(video.videoWidth >> 1, video.videoHeight >> 1, 1, 1).data;
  return (data[0] + data[1] + data[2]) / 3;
}})"""
# Of the videos of `filmed`, in this order; depth is shown in colours, which say nothing of the frame here.
SIDE, WRIST = 0, 2


class Browser(Protocol):
    errors: list[str]

    def open(self, address: str) -> None: ...
    def run(self, script: str) -> Any: ...
    def wait(self, script: str, seconds: float = ...) -> None: ...
    def press(self, key: str, *, shift: bool = ...) -> None: ...
    def click(self, x: float, y: float) -> None: ...
    def prefer(self, scheme: str) -> None: ...


@pytest.fixture(scope="module")
def page(filmed: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return write_view(filmed, tmp_path_factory.mktemp("page") / "view").path.as_uri()


@pytest.fixture
def show(chromium: Browser) -> Callable[[str], Browser]:
    """Open an address, wait until all videos show their frame, and see that nothing went wrong."""

    def _show(address: str) -> Browser:
        chromium.errors.clear()
        chromium.open(address)
        chromium.wait(SETTLED)
        assert not chromium.errors
        return chromium

    return _show


def state(browser: Browser) -> dict[str, str]:
    return browser.run("({...document.body.dataset})")


def row_shown(browser: Browser, video: int) -> float:
    return (browser.run(BRIGHTNESS)[video] - 30) / 5


def test_it_opens_at_the_first_episode_and_says_what_is_there(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(page)
    assert state(browser)["episode"] == "000000"
    text = browser.run("document.body.innerText")
    assert "pick it up" in text
    assert "50.0 %" in text
    assert "success, 1 of 2" in text
    caption = browser.run("document.querySelectorAll('#pictures figcaption')[1].textContent")
    assert caption == "side depth540 to 541.1 mm", "what the frames around this one show"
    assert browser.run("document.title") == "filmed"
    assert browser.run("document.querySelectorAll('#list li').length") == 3
    assert browser.run(f"{VIDEOS}.length") == 3


@pytest.mark.parametrize("row", [0, 1, 9, 10, 11, 23, 38, 39])
def test_the_address_leads_to_the_very_frame(row: int, page: str, show: Callable[[str], Browser]) -> None:
    browser = show(f"{page}#episode=000000&t={row}")
    assert state(browser)["frame"] == str(row)
    assert row_shown(browser, SIDE) == pytest.approx(row, abs=0.45)
    assert row_shown(browser, WRIST) == pytest.approx(row, abs=0.45)


def test_many_quick_seeks_end_at_the_last_one(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(page)
    browser.run("for (const row of [3, 30, 7, 39, 1, 22]) player.seek(row)")
    browser.wait(f"{SETTLED} && {VIDEOS}.every((v) => Math.floor(v.currentTime * 30) === 22)")
    assert row_shown(browser, SIDE) == pytest.approx(22, abs=0.45)
    assert row_shown(browser, WRIST) == pytest.approx(22, abs=0.45)


def test_it_plays_all_cameras_in_step_to_the_end_and_stops(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(page)
    browser.press(" ")
    assert state(browser)["playing"] == "1"
    apart: list[float] = []
    seen: set[int] = set()
    end = time.monotonic() + 15
    while state(browser)["playing"] == "1" and time.monotonic() < end:
        times = browser.run(f"[player.frame, ...{VIDEOS}.map((v) => v.currentTime)]")
        seen.add(times[0])
        apart.append(30 * (max(times[1:]) - min(times[1:])))
        time.sleep(0.01)
    assert state(browser)["playing"] == "0"
    assert state(browser)["frame"] == "39"
    assert len(seen) > 5
    # Videos that are more than two frames apart are pulled together; what is measured here may be one frame older.
    assert float(np.median(apart)) < 2


def test_without_videos_the_clock_plays(tmp_path: Path, show: Callable[[str], Browser]) -> None:
    info = DatasetInfo(
        frequency=30,
        features=(Feature(key="observation/joints", shape=(2,), dtype="float64"),),
        setup={},
        instruction="",
    )
    with DatasetWriter.open(tmp_path / "data", info) as writer:
        episode = writer.episode("a", seed=0)
        for row in range(20):
            episode.add({"observation/joints": np.array([row, -row], np.float64)})
        episode.finish(True)
    browser = show(write_view(tmp_path / "data").path.as_uri() + "#play")
    assert browser.run(f"{VIDEOS}.length") == 0
    browser.wait("document.body.dataset.frame === '19' && document.body.dataset.playing === '0'")
    assert browser.run("document.querySelector('.plot .value').textContent") == "19.00"


def test_keys_step_through_frames_and_episodes(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(page)
    browser.press("ArrowRight")
    browser.press("ArrowRight")
    browser.press("ArrowLeft")
    assert state(browser)["frame"] == "1"
    browser.press("ArrowRight", shift=True)
    assert state(browser)["frame"] == "11"
    browser.wait(f"{SETTLED} && {VIDEOS}.every((v) => Math.floor(v.currentTime * 30) === 11)")
    assert row_shown(browser, SIDE) == pytest.approx(11, abs=0.45)
    browser.press("End")
    assert state(browser)["frame"] == "39"
    browser.press("j")
    browser.wait("document.body.dataset.episode === '000001'")
    browser.press("k")
    browser.wait("document.body.dataset.episode === '000000'")


def test_a_click_into_a_plot_or_the_time_line_seeks(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(page)
    for selector, left, right in (("#lanes", 0, 0), (".plot .area", 46, 8)):
        browser.run(f"document.querySelector('{selector}').scrollIntoView({{block: 'center'}})")
        box = browser.run(
            f"(({{x, y, width, height}}) => [x, y, width, height])"
            f"(document.querySelector('{selector}').getBoundingClientRect())"
        )
        browser.click(box[0] + left + 0.25 * (box[2] - left - right), box[1] + box[3] / 2)
        assert int(state(browser)["frame"]) == pytest.approx(0.25 * 39, abs=1)
        browser.press("Home")


def test_two_episodes_are_shown_side_by_side_over_the_longer_one(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(f"{page}#episode=000001&compare=000000&t=35")
    assert state(browser) | {"rows": "40", "compare": "000000", "frame": "35"} == state(browser)
    assert browser.run(f"{VIDEOS}.length") == 6
    assert row_shown(browser, SIDE) == pytest.approx(24, abs=0.45)  # the shorter one rests at its end
    assert row_shown(browser, 3 + SIDE) == pytest.approx(35, abs=0.45)
    assert " / " in browser.run("document.querySelector('.plot .value').textContent")
    browser.press("Escape")
    browser.wait(f"document.body.dataset.compare === '' && {VIDEOS}.length === 3")
    browser.press("c")
    browser.wait(f"document.body.dataset.compare === '000002' && {VIDEOS}.length === 6")


def test_filters_leave_what_fits(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(page)

    def shown(**filters: str) -> list[str]:
        fields = ", ".join(f"{name}: '{value}'" for name, value in filters.items())
        return browser.run(f"(list.set({{text: '', verdict: 'all', flaw: 'any', order: 'id', {fields}}}), list.shown)")

    assert shown() == ["000000", "000001", "000002"]
    assert shown(verdict="success") == ["000000"]
    assert shown(verdict="failure") == ["000001"]
    assert shown(verdict="unknown") == ["000002"]
    assert shown(text="slip") == ["000001"]
    assert shown(text="PICK 0002") == ["000002"]
    assert shown(text="nothing") == []
    assert shown(order="longest") == ["000000", "000002", "000001"]
    assert shown(order="shortest") == ["000001", "000002", "000000"]
    assert shown(flaw="stale") == ["000000", "000001", "000002"]
    assert shown(flaw="none") == []
    assert browser.run("[...document.getElementById('flaw').options].map((o) => o.value)") == [
        "any", "none", "some", "stale", "gap",
    ]  # fmt: skip
    browser.press("/")
    browser.press("j")  # goes into the search field
    assert browser.run("document.getElementById('search').value") == "j"
    assert state(browser)["shown"] == "0"


def test_a_long_list_has_elements_only_where_it_is_looked_at(
    filmed: Path, tmp_path: Path, show: Callable[[str], Browser]
) -> None:
    report = write_view(filmed, tmp_path / "view", episodes=["000000"])
    script = report.path.with_name("dataset.js")
    head, line, tail = script.read_text("ascii").split("\n", 2)
    more = [line.replace('"000000"', f'"{number:06d}"') for number in range(1, 5000)]
    script.write_text("\n".join([head, ",\n".join([line, *more]), tail]), "ascii")
    browser = show(report.path.as_uri())
    assert state(browser)["shown"] == "5000"
    items = "document.querySelectorAll('#list li').length"
    assert 100 <= browser.run(items) <= 400
    assert browser.run("document.getElementById('list').scrollHeight") > 5000 * 30
    browser.run("document.getElementById('list').scrollTop = 1e9")
    browser.wait("document.getElementById('list').lastChild.textContent.includes('004999')")
    assert browser.run(items) <= 400
    current = "document.querySelector('[aria-current]').getBoundingClientRect()"
    for name in ("002345", "000700", "004700", "004699"):
        browser.run(f"list.mark('{name}', null)")
        time.sleep(0.2)  # what is around it is filled
        top, bottom, height = browser.run(f"(({{top, bottom}}) => [top, bottom, innerHeight])({current})")
        assert 0 < top < bottom <= height, "what is marked is in sight"
        assert browser.run("document.querySelector('[aria-current] .id').textContent") == name
    browser.run("list.set({text: '4999'})")
    assert browser.run(items) == 1


def test_flaws_are_marked_on_the_time_line(page: str, show: Callable[[str], Browser]) -> None:
    browser = show(page)
    assert browser.run("[...document.querySelectorAll('.lane span')].map((s) => s.textContent)") == [
        "", "side", "loop",
    ]  # fmt: skip
    # Where the second lane has a colour: rows 5 to 7 of 0 to 39.
    share = browser.run(
        """(() => { const canvas = document.querySelectorAll('.lane canvas')[1];
        const {data} = canvas.getContext('2d').getImageData(0, canvas.height >> 1, canvas.width, 1);
        const marked = [...Array(canvas.width).keys()].filter((x) => data[4 * x + 3] > 128);
        return [marked[0] / canvas.width, marked.at(-1) / canvas.width, marked.length / canvas.width]; })()"""
    )
    np.testing.assert_allclose(share, [5 / 39, 7 / 39, 2 / 39], atol=0.005)
    assert "gaps 2" in browser.run("document.getElementById('flaws').innerText")


def test_dark_is_dark(page: str, show: Callable[[str], Browser], chromium: Browser) -> None:
    brightness: list[int] = []
    for scheme in ("light", "dark"):
        chromium.prefer(scheme)
        browser = show(page)
        colour = browser.run("getComputedStyle(document.body).backgroundColor")
        brightness.append(sum(int(number) for number in colour[4:-1].split(",")))
    chromium.prefer("light")
    assert brightness[0] > 600 > 150 > brightness[1]


@pytest.mark.parametrize(
    "episode_id",
    ["<img src=x onerror='window.hacked=1'>", "100 % & #hash?x=1", "quote\"'`${1}", "__proto__", "übung-日本", "-dash"],
)
def test_words_of_the_dataset_are_words(episode_id: str, tmp_path: Path, show: Callable[[str], Browser]) -> None:
    evil = "</script><script>window.hacked=1</script><b onclick=x>\u2028 \\u003c"
    camera = Feature(key="observation/frames/<i>/rgb", shape=(16, 16, 3), dtype="uint8", encoding="jpeg", unit=evil)
    joints = Feature(key="observation/<b>", shape=(1,), dtype="float64", unit=evil)
    info = DatasetInfo(frequency=30, features=(camera, joints), setup={evil: evil, "robot": evil}, instruction=evil)
    with DatasetWriter.open(tmp_path / "<b>data", info) as writer:
        episode = writer.episode(episode_id, seed=2**63)
        for _ in range(3):
            episode.add({camera.key: np.zeros((16, 16, 3), np.uint8), joints.key: np.zeros(1)})
        episode.finish(False, {"failure": evil, evil: evil})
    browser = show(f"{write_view(tmp_path / '<b>data').path.as_uri()}#episode={quote(episode_id, safe='')}&t=2")
    assert browser.run("window.hacked") is None
    assert state(browser)["episode"] == episode_id
    assert state(browser)["frame"] == "2"
    assert browser.run("document.querySelectorAll('img, body i b, [onclick]').length") == 0
    assert browser.run("document.querySelectorAll('script').length") == 6
    text = browser.run("document.body.textContent")
    assert episode_id in text
    assert evil in text
    assert str(2**63) in text


def test_a_damaged_episode_says_so_and_the_others_are_shown(
    tmp_path: Path, filmed: Path, show: Callable[[str], Browser], chromium: Browser
) -> None:
    copy = tmp_path / "copy"
    _link(filmed, copy)
    (copy / "episodes/000001/steps.parquet").unlink()
    (copy / "episodes/000001/steps.parquet").write_bytes(b"PAR1")
    report = write_view(copy)
    assert (report.rendered, report.damaged) == (2, 1)
    browser = show(report.path.as_uri())
    browser.press("j")
    browser.wait("document.body.dataset.damaged === '1'")
    assert "000001 is damaged: Cannot read 000001/steps.parquet" in browser.run(
        "document.getElementById('message').innerText"
    )
    browser.press("j")
    browser.wait("document.body.dataset.episode === '000002'")


def test_vp9_plays_too(filmed: Path, tmp_path: Path, show: Callable[[str], Browser]) -> None:
    report = write_view(filmed, tmp_path / "view", episodes=["000001"], options=ClipOptions(codec="vp9"))
    browser = show(f"{report.path.as_uri()}#t=17")
    assert row_shown(browser, WRIST) == pytest.approx(17, abs=0.45)


def test_the_report_is_the_same_page_in_one_file(filmed: Path, tmp_path: Path, show: Callable[[str], Browser]) -> None:
    _link(filmed, tmp_path / "copy")
    alone = write_report(tmp_path / "copy").rename(tmp_path / "mailed.html")
    browser = show(f"{alone.as_uri()}#episode=000001&t=17")
    assert state(browser) | {"episode": "000001", "frame": "17"} == state(browser)
    assert row_shown(browser, SIDE) == pytest.approx(17, abs=0.45)
    assert row_shown(browser, WRIST) == pytest.approx(17, abs=0.45)
    browser.press("k")
    browser.wait("document.body.dataset.episode === '000000'")


def test_a_page_that_was_interrupted_says_so(filmed: Path, tmp_path: Path, chromium: Browser) -> None:
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_view(filmed, tmp_path / "view", on_progress=stop)
    chromium.open((tmp_path / "view/index.html").as_uri())
    assert "was not completed" in chromium.run("document.getElementById('message').innerText")


def _link(source: Path, target: Path) -> None:
    for path in source.rglob("*"):
        if path.is_file():
            place = target / path.relative_to(source)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.hardlink_to(path)
