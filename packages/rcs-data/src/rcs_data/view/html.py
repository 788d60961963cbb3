"""Pages in HTML: their frame and what they are made of. All pages of this library are made here, so none runs a text.

Text becomes HTML in `element` alone, which escapes whatever is not `Html` already.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

WEB = Path(__file__).with_name("web")
"""The style and the scripts that pages share."""

_EMPTY = frozenset({"img", "link", "br"})


class Html(str):
    """Text that is HTML: made by this module, or constant."""

    __slots__ = ()


def joined(parts: Iterable[object]) -> Html:
    """Return parts one after the other, escaped if they are not HTML; None and "" are nothing."""
    return Html(
        "".join(part if isinstance(part, Html) else html.escape(str(part)) for part in parts if part is not None)
    )


def element(tag: str, /, *content: object, **attributes: object) -> Html:
    """Return an element.

    Args:
        tag: Its name.
        content: Content of the element; text that is not `Html` is escaped.
        attributes: By name, with "_" for "-", and one at the end left away, as in `class_`. True is an attribute
            without a value; None and False are none.
    """
    words = "".join(
        f" {name.rstrip('_').replace('_', '-')}" + ("" if value is True else f'="{html.escape(str(value))}"')
        for name, value in attributes.items()
        if value is not None and value is not False
    )
    return Html(f"<{tag}{words}>" + ("" if tag in _EMPTY else f"{joined(content)}</{tag}>"))


def table(rows: Iterable[Sequence[object]], head: Sequence[object] = ()) -> Html:
    """Return a table, with a line of headings, or with the first cell of each row as its heading."""
    lines = [element("tr", *(element("th", cell) for cell in head))] if head else []
    for row in rows:
        cells = [element("th" if not head and i == 0 else "td", cell) for i, cell in enumerate(row)]
        lines.append(element("tr", *cells))
    return element("table", *lines)


def figure(content: object, *caption: object, is_below: bool = True, **attributes: object) -> Html:
    """Return a figure with its caption below or above; attributes as for `element`."""
    words = element("figcaption", *caption)
    return element("figure", *((content, words) if is_below else (words, content)), **attributes)


def film(source: str | bytes) -> Html:
    """Return a video, silent and repeated: the name of a file beside the page, or the bytes of an MP4 file."""
    address = (
        f"data:video/mp4;base64,{base64.b64encode(source).decode('ascii')}" if isinstance(source, bytes) else source
    )
    return element("video", controls=True, muted=True, loop=True, playsinline=True, preload="metadata", src=address)


def header(title: str, words: str = "", counts: Mapping[str, object] | None = None) -> Html:
    """Return the head of a page: its title, a line of words, and figures by what they are of."""
    figures = [element("div", element("dt", name), element("dd", value)) for name, value in (counts or {}).items()]
    line = element("p", words, id="instruction") if words else None
    return element(
        "header", element("div", element("h1", title), line, class_="title"), element("dl", *figures, id="counts")
    )


def page(title: str, *body: object, assets: Html | None = None) -> Html:
    """Return a whole page.

    Args:
        title: Title of the window.
        body: Content of the page; text that is not `Html` is escaped.
        assets: Its style; None for the one that all pages share.
    """
    about = Html(
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="referrer" content="no-referrer">'
    )
    head = element("head", about, element("title", title), style() if assets is None else assets)
    return Html(f'<!doctype html>\n<html lang="en">\n{head}\n{element("body", *body)}\n</html>\n')


def style() -> Html:
    """Return the style that all pages share, as a `style` element."""
    return Html(f"<style>\n{web('viewer.css')}</style>")


def script(code: str) -> Html:
    """Return code as a `script` element; values in it must come from `json_text`."""
    return Html(f"<script>\n{code}</script>")


def json_text(values: Any) -> str:
    """Return values as JSON in ASCII that neither ends the tag of a script nor begins another."""
    return json.dumps(values, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def web(name: str) -> str:
    """Return one of the files that pages share."""
    return (WEB / name).read_text("utf-8")
