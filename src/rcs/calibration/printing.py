"""A board on paper: a PDF, true to scale, with its sizes and a ruler printed below it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rcs.calibration.board import CELLS, Board
from rcs.errors import InvalidSetup

SHEETS = {
    "A4": (0.210, 0.297),
    "A3": (0.297, 0.420),
    "A2": (0.420, 0.594),
    "A1": (0.594, 0.841),
    "A0": (0.841, 1.189),
}
"""Sheets of paper (ISO 216), width and height [m]; the smallest on which a board fits is taken."""
EDGE = 0.005
"""White border that printers leave [m]."""
FOOT = 0.035
"""Room for text and ruler below the board [m]."""
RULER = 0.1
"""Length of the ruler [m]."""
POINTS = 72 / 0.0254
"""Points per metre (PDF 1.7, 8.3.2.3)."""

Rectangle = tuple[float, float, float, float]
"""Left, top, width, height on the sheet [m]."""


def sheet_of(board: Board) -> tuple[str, tuple[float, float]]:
    """Return the sheet on which a board is printed: its name, width and height [m].

    Raises:
        InvalidSetup: The board fits on none.
    """
    width, height = board.size
    for name, (across, down) in SHEETS.items():
        if width + 2 * EDGE <= across + 1e-9 and height + FOOT + 2 * EDGE <= down + 1e-9:
            return name, (across, down)
    raise InvalidSetup(
        f"The board has {width:.3f} x {height:.3f} m and fits on no sheet up to A0; choose fewer or smaller tags."
    )


def text_of(board: Board) -> list[str]:
    """Return the lines printed below a board."""
    width, height = board.size
    return [
        f"AprilTag 36h11, tags {board.ids[0]} to {board.ids[-1]}, {board.rows} x {board.columns}; "
        f"tag {1000 * board.tag_size:g} mm, gap {1000 * board.gap:g} mm, board {1000 * width:g} x {1000 * height:g} mm",
        f"Print at 100 %, not fitted to the page. Measure: the ruler has {1000 * RULER:g} mm, a black square "
        f"{1000 * board.tag_size:g} mm.",
    ]


def black_cells(board: Board) -> Iterator[Rectangle]:
    """Yield the black parts of the tags, runs of cells in a row, as rectangles on the sheet."""
    across, _ = sheet_of(board)[1]
    cell, pitch = board.tag_size / CELLS, board.tag_size + board.gap
    left = (across - board.size[0]) / 2 + board.gap / 2
    for i, number in enumerate(board.ids):
        row, column = divmod(i, board.columns)
        for y, line in enumerate(board.cells(number)):
            edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
            for start, end in edges.reshape(-1, 2):
                yield (
                    left + column * pitch + float(start) * cell,
                    EDGE + board.gap / 2 + row * pitch + y * cell,
                    float(end - start) * cell,
                    cell,
                )


def _ruler(board: Board) -> Iterator[Rectangle]:
    """Yield the ruler's line and its marks, one per centimetre."""
    across, _ = sheet_of(board)[1]
    left, top = (across - RULER) / 2, EDGE + board.size[1] + 0.022
    yield left, top, RULER, 0.0004
    for i in range(11):
        yield left + i * RULER / 10 - 0.0001, top - (0.004 if i % 5 == 0 else 0.002), 0.0002, 0.004


def to_pdf(board: Board) -> bytes:
    """Return a board as a PDF of one page, drawn with lines and not with pixels.

    Raises:
        InvalidSetup: It fits on no sheet.
        MissingDependency: OpenCV, which knows the tags, is not installed.
    """
    _, (across, down) = sheet_of(board)
    drawing = ["0 g"]
    for left, top, width, height in [*black_cells(board), *_ruler(board)]:
        drawing.append(f"{left * POINTS:.4f} {(down - top - height) * POINTS:.4f} {width * POINTS:.4f} "
                       f"{height * POINTS:.4f} re")  # fmt: skip
    drawing.append("f")
    for i, line in enumerate(text_of(board)):
        below = EDGE + board.size[1] + 0.007 + 0.005 * i
        drawing.append(f"BT /F 7 Tf {0.012 * POINTS:.2f} {(down - below) * POINTS:.2f} Td ({line}) Tj ET")
    stream = "\n".join(drawing).encode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {across * POINTS:.4f} {down * POINTS:.4f}] /Contents 4 0 R "
        "/Resources << /Font << /F 5 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    parts, offset, offsets = [b"%PDF-1.4\n"], 9, list[int]()
    for number, body in enumerate(objects, start=1):
        part = b"%d 0 obj\n%s\nendobj\n" % (number, body)
        offsets.append(offset)
        offset += len(part)
        parts.append(part)
    table = b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    table += b"".join(b"%010d 00000 n \n" % one for one in offsets)
    trailer = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, offset)
    return b"".join([*parts, table, trailer])
