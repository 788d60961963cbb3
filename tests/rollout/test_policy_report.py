"""The page about an evaluation tells its figures, and what a policy says of itself is text."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rcs.rollout import policy_report

EVIL = "<img src=x onerror=hacked()>"


def test_figures_and_films_are_on_the_page_and_words_are_words(tmp_path: Path) -> None:
    (tmp_path / "000001.mp4").write_bytes(b"")
    metadata = SimpleNamespace(
        name=EVIL, checkpoint=EVIL, checkpoint_hash="", action=[SimpleNamespace(name=EVIL, meaning="absolute")],
        horizon=16, rate=30.0,
    )  # fmt: skip
    cameras = SimpleNamespace(names=(EVIL,))
    setup = SimpleNamespace(task="PickCuboid", robot_label="fr3", frequency=30.0, stepping="async", cameras=cameras)
    evaluation = SimpleNamespace(setup=setup, agent_name=f"vla://{EVIL}", seed=0, first_seed=0, videos=2, out=tmp_path)
    results = [
        SimpleNamespace(
            seed=i,
            success=i > 0,
            failure="policy" if i == 0 else None,
            message=EVIL if i == 0 else None,
            steps=9,
            reward=0.5,
        )
        for i in (0, 1)
    ]
    summary = SimpleNamespace(
        interval=(0.1, 0.9), successes=1, judged=2, failures=Counter([EVIL]), results=results,
        attempts=[SimpleNamespace(number=0), SimpleNamespace(number=1)],
    )  # fmt: skip
    page: Any = policy_report._page
    evaluation.videos = 1
    assert "<video" not in page(evaluation, summary, metadata, {}), "what it has not filmed is not its own"
    evaluation.videos = 2
    text = page(evaluation, summary, metadata, {"mode": EVIL})
    assert "<img" not in text
    assert text.count("<video") == 1
    assert 'src="000001.mp4"' in text
    for words in (
        "Success in 1 of 2 judged",
        "<b>50.0 %</b>",
        "10.0 to 90.0 %",
        "left:50.00%",
        "<td>failure</td>",
        "policy: &lt;img",
    ):
        assert words in text
