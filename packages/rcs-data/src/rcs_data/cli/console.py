"""The console of commands: text of users and datasets is printed verbatim."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.text import Text

from rcs_data.files.output import OnProgress

# Control codes in a dataset must not move the cursor, colour the screen or rename the window.
_CONTROLS = {code: "\ufffd" for code in (*range(0x20), *range(0x7F, 0xA0)) if chr(code) not in "\n\t"}


class PlainConsole(Console):
    """A console without markup: an instruction "[/bold]" is printed as it is."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return text to print, without control characters and without interpreting markup or emoji names."""
        how: dict[str, Any] = {**options, "markup": False, "emoji": False}
        return super().render_str(text.translate(_CONTROLS), **how)


def plain_console(*, stderr: bool = False, **options: Any) -> Console:
    """Return a console for text of users and datasets, with options of `rich.console.Console`."""
    how: dict[str, Any] = {"soft_wrap": True, **options}
    return PlainConsole(stderr=stderr, markup=False, emoji=False, highlight=False, **how)


@contextmanager
def progress(doing: str) -> Generator[OnProgress]:
    """Show a bar while the block runs; yield the function that moves it."""
    from rich.progress import Progress  # most commands show none

    console = plain_console(stderr=True, soft_wrap=False)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(doing, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total or None)
