"""A board's corners, picture and prints agree: what is printed is what is looked for."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rcs.calibration import Board, detect
from rcs.calibration.printing import POINTS, sheet_of, to_pdf
from rcs.errors import InvalidSetup


def test_corners_go_round_every_tag_from_the_top_left() -> None:
    board = Board(rows=2, columns=3, tag_size=0.04, gap=0.01)
    sides = np.diff(board.corners, axis=1, append=board.corners[:, :1])
    np.testing.assert_allclose(sides[:, 0], np.tile([0.04, 0, 0], (6, 1)), atol=1e-12)
    np.testing.assert_allclose(sides[:, 1], np.tile([0, -0.04, 0], (6, 1)), atol=1e-12)
    np.testing.assert_allclose(board.corners.mean(axis=(0, 1)), 0, atol=1e-12)
    assert board.size == pytest.approx((0.15, 0.10))


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"rows": 0}, "rows"),
        ({"tag_size": float("nan")}, "tag_size"),
        ({"gap": 0.001}, "gap"),
        ({"first_id": 586}, "more than the family"),
    ],
)
def test_a_board_that_cannot_be_is_refused(fields: dict[str, float], text: str) -> None:
    with pytest.raises(InvalidSetup, match=text):
        Board(**fields)  # pyright: ignore[reportArgumentType]


def test_a_board_survives_json_and_unknown_fields_are_refused() -> None:
    board = Board(rows=3, tag_size=0.03)
    assert Board.from_json(board.to_json()) == board
    with pytest.raises(InvalidSetup, match="tag_sise"):
        Board.from_json({"tag_sise": 0.1})


@pytest.mark.extras
def test_tags_are_found_in_the_picture_where_the_corners_are() -> None:
    board = Board(rows=2, columns=3, first_id=7)
    pixels = 16 * 8 / board.tag_size  # per metre
    border = 40
    found = detect(board, np.pad(board.picture(16), border, constant_values=255))
    assert found.ids.tolist() == board.ids
    width, height = board.size
    expected = (board.corners[..., :2] * (1, -1) + (width / 2, height / 2)) * pixels + border - 0.5
    np.testing.assert_allclose(found.corners, expected, atol=0.3)


@pytest.mark.extras
def test_a_tag_that_is_there_twice_and_strange_tags_are_left_out() -> None:
    board = Board()
    page = np.pad(board.picture(8), 20, constant_values=255)
    strange = np.pad(Board(first_id=100).picture(8), 20, constant_values=255)
    twice = np.pad(Board(rows=1, columns=1, first_id=2).picture(8), 20, constant_values=255)
    wide = np.full((page.shape[0], page.shape[1] + twice.shape[1] + strange.shape[1]), 255, np.uint8)
    wide[:, : page.shape[1]] = page
    wide[: twice.shape[0], page.shape[1] : page.shape[1] + twice.shape[1]] = twice
    wide[:, page.shape[1] + twice.shape[1] :] = strange
    assert detect(board, wide).ids.tolist() == [0, 1, 3]


@pytest.mark.extras
@pytest.mark.parametrize("picture", [np.zeros((4, 4)), np.zeros((4, 4, 4), np.uint8), np.zeros(5, np.uint8)])
def test_what_is_no_picture_is_refused(picture: np.ndarray) -> None:
    with pytest.raises(InvalidSetup, match="valid is"):
        detect(Board(), picture)


@pytest.mark.extras
def test_the_pdf_is_true_to_scale() -> None:
    board = Board(tag_size=0.06, gap=0.02)
    text = to_pdf(board).decode("latin-1")
    page = [float(value) for value in re.findall(r"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", text)[0]]
    np.testing.assert_allclose(np.array(page) / 72 * 25.4, (210, 297), atol=0.01)
    # Every tag's frame has a black row of the whole width at the top.
    rectangles = np.array(re.findall(r"([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re", text), float)
    rows = rectangles[np.isclose(rectangles[:, 2], 0.06 * POINTS, atol=1e-3)]
    assert len(rows) == 4 * 2
    assert np.ptp(rows[:, 0]) == pytest.approx(0.08 * POINTS, abs=1e-3), "two columns are a tag and a gap apart"
    assert "tag 60 mm, gap 20 mm" in text
    starts = [int(value) for value in re.findall(r"(\d{10}) 00000 n", text)]
    assert all(text[start:].startswith(f"{i} 0 obj") for i, start in enumerate(starts, start=1))


def test_a_board_takes_the_smallest_sheet_and_one_that_fits_on_none_is_refused() -> None:
    assert sheet_of(Board())[0] == "A4"
    assert sheet_of(Board(rows=3))[0] == "A3"
    with pytest.raises(InvalidSetup, match="no sheet"):
        sheet_of(Board(tag_size=1.0, gap=0.3))


def test_a_sheet_of_paper_has_as_many_points_as_in_every_pdf() -> None:
    width, height = sheet_of(Board(rows=2, columns=2, tag_size=0.03, gap=0.01))[1]
    assert (round(width * POINTS), round(height * POINTS)) == (595, 842)  # A4
