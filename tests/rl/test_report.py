"""The report of a run has its figures, curves and settings, and none of its words is HTML."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from rcs.rl import report
from rcs.rl.metrics import EPISODES, JUDGED, RATE, SPEED, SUCCESSES, Row
from rcs.rl.recipes import RECIPES

EVIL = "<img src=x onerror=hacked()>"


def test_the_page_has_rates_curves_and_settings_and_words_are_words(tmp_path: Path) -> None:
    recipe = RECIPES["PickCuboid", "ppo"]
    training = replace(recipe, steps=10_000, setup=replace(recipe.setup, task=EVIL))
    rows = [
        Row(steps=steps, seconds=steps / 100, time=0.0, figures={
            EPISODES: 10, JUDGED: 10, SUCCESSES: wins, RATE: wins / 10, SPEED: 700.0, "train/value_loss": 1 / wins,
        })
        for steps, wins in ((5_000, 2), (10_000, 9))
    ]  # fmt: skip
    page: Any = report._page
    text = page(tmp_path, training, rows, [])
    assert "<img" not in text
    assert text.count("<svg") == 4
    for name in ("wide", "narrow"):  # of the rate, one for screens and one for phones
        assert f'<div class="{name}"><figure' in text
    for words in ("9 of 10 (60 to 98 %)", "Loss of the value", "<h2>Environment</h2>", "1 min 40 s", "<dd>700</dd>"):
        assert words in text
    assert "No evaluation was judged." in page(tmp_path, training, [], [])
