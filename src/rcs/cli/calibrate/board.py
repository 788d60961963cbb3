"""`rcs calibrate board`: a board of AprilTags to print."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rcs_data.cli.console import plain_console

from rcs.calibration import Board
from rcs.calibration.printing import sheet_of, text_of, to_pdf
from rcs.errors import InvalidSetup


@dataclass(kw_only=True)
class BoardOptions:
    """A board of AprilTags."""

    rows: int = Board.rows
    """Rows of tags."""
    columns: int = Board.columns
    """Columns of tags."""
    tag_size_mm: float = 1000 * Board.tag_size
    """Edge of a tag's black square as measured on the print [mm]."""
    gap_mm: float | None = None
    """White between two tags [mm]; a quarter of a tag by default."""
    first_id: int = Board.first_id
    """Number of the tag at the top left."""

    @property
    def board(self) -> Board:
        """The board."""
        size = self.tag_size_mm / 1000
        gap = size / 4 if self.gap_mm is None else self.gap_mm / 1000
        return Board(rows=self.rows, columns=self.columns, tag_size=size, gap=gap, first_id=self.first_id)


@dataclass(kw_only=True)
class BoardCommand(BoardOptions):
    """Draw a board of AprilTags to print, as a PDF, true to scale.

    Print it at 100 %, fix it to something flat and stiff, measure a tag, and give the measured size to the other
    commands as `--tag-size-mm`.
    """

    out: Path = field(default_factory=lambda: Path("board"))
    """Path of the file; its ending is .pdf."""

    def run(self) -> int:
        """Draw it and print where it is."""
        if not self.out.name:
            raise InvalidSetup(f"out is {str(self.out)!r}; valid is the path of a file, such as board.pdf.")
        board = self.board
        sheet, _ = sheet_of(board)
        self.out.parent.mkdir(parents=True, exist_ok=True)
        console = plain_console()
        path = self.out if self.out.suffix.lower() == ".pdf" else self.out.with_name(f"{self.out.name}.pdf")
        path.write_bytes(to_pdf(board))
        console.print(f"{path}: on a sheet of {sheet}")
        for line in text_of(board):
            console.print(line)
        return 0
