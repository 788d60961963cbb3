"""A page of pictures that lie beside it, in groups, in the looks of the other pages."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

from rcs_data.view.page import WEB


def pictures_page(title: str, groups: Mapping[str, Sequence[tuple[str, str]]]) -> str:
    """Return the page as HTML.

    Args:
        title: The page's.
        groups: For each heading the captions and the file names of its pictures.
    """
    parts: list[str] = []
    for heading, pictures in groups.items():
        parts.append(f"<h2>{html.escape(heading)}</h2>")
        for caption, name in pictures:
            words = html.escape(caption)
            parts.append(
                f'<figure><img src="{html.escape(name)}" alt="{words}"><figcaption>{words}</figcaption></figure>'
            )
    style = (WEB / "viewer.css").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>\n{style}</style></head>"
        f'<body><header><h1>{html.escape(title)}</h1></header><main class="gallery">{"".join(parts)}</main></body>'
        "</html>\n"
    )
