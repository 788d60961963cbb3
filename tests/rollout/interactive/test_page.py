from __future__ import annotations

import re

import pytest

from rcs.rollout.interactive.page import as_line


def test_html_is_shown_and_not_rendered() -> None:
    line = as_line("<img src=x onerror=alert(1)> & more")
    assert "<" not in line
    assert ">" not in line
    assert line.startswith("&lt;img src=x onerror=alert")
    assert "&amp; more" in line


@pytest.mark.parametrize(
    "words", ["[a](javascript:b)", "**a**", "# a", "`a`", "a_b_c", "{a}", "![a](b)", "~~a~~", "a\\*b"]
)
def test_no_character_of_markdown_is_left_to_mean_something(words: str) -> None:
    line = as_line(words)
    assert re.sub(r"\\(.)", r"\1", line) == words
    assert not re.search(r"[\\`*_{}\[\]()#!~]", re.sub(r"\\.", "", line))


def test_several_lines_become_one() -> None:
    assert as_line("  a\n\n    b\r\n> c\u2028d") == "a b &gt; c d"


def test_what_is_no_text_is_shown_as_its_text() -> None:
    assert as_line(12) == "12"
