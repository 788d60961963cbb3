"""Words of others in the Markdown of a page, whose browsers also take HTML and scripts in it for what they are."""

from __future__ import annotations

import html
import re

_SPECIAL = re.compile(r"[\\`*_{}\[\]()#+\-.!|~]")
"""Characters that may mean something in Markdown; those of HTML are replaced before."""


def as_line(words: object) -> str:
    """Return words as Markdown that shows just these, in one line: no HTML, no links, no emphasis."""
    return _SPECIAL.sub(r"\\\g<0>", html.escape(" ".join(str(words).split()), quote=False))
