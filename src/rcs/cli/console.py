"""What commands print on: text comes out as it is stored, whatever is in it."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

# Codes that move the cursor, colour the screen or rename the window: from a dataset they are nobody's wish.
_CONTROLS = {code: "\ufffd" for code in (*range(0x20), *range(0x7F, 0xA0)) if chr(code) not in "\n\t"}


class PlainConsole(Console):
    """A console that takes text for text: an instruction "[/bold]" is printed, and is no markup."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text to print, without control characters; markup, emoji names and numbers are left as they are."""
        how: dict[str, Any] = {**options, "markup": False, "emoji": False}
        return super().render_str(text.translate(_CONTROLS), **how)


def plain_console(*, stderr: bool = False, **options: Any) -> Console:
    """Return a console for text of datasets and users.

    Args:
        stderr: Whether it prints where errors go.
        options: Of `rich.console.Console`.
    """
    how: dict[str, Any] = {"soft_wrap": True, **options}
    return PlainConsole(stderr=stderr, markup=False, emoji=False, highlight=False, **how)
