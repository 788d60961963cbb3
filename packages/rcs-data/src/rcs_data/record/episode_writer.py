"""Records one episode row by row; what was recorded survives a kill."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.files.about import MOST_SEED
from rcs_data.files.durable import as_json, disk_errors, remove_folder, remove_tree, sealed, write_file
from rcs_data.files.layout import ABORTED_FILE, OPEN_FOLDER, ROWS_FILE, check_episode_id, new_trash
from rcs_data.files.stream import EpisodeHeader, StreamWriter
from rcs_data.files.text import check_text, mended_text
from rcs_data.index.index import Index
from rcs_data.read.episode_record import EpisodeRecord
from rcs_data.record.compact import compact, library_versions
from rcs_data.record.rows import RowBuffer, Value

_log = logging.getLogger(__name__)

# Age of the oldest row that a kill can lose [s]. Writing each row at once would cost 40 µs per row.
_FLUSH_AFTER_S = 0.25

State = Literal["open", "finished", "discarded", "aborted"]


class EpisodeWriter:
    """One episode being recorded; made by `DatasetWriter.episode`. Not thread-safe.

    Rows are written at the latest with the first row 0.25 s after the last write, so a kill loses at most that much.
    Left as a context manager without `finish`, the episode is aborted: its rows stay until `recover` makes an episode
    of them or a resumed recording discards them.
    """

    def __init__(self, index: Index, episode_id: str, seed: int | None, instruction: str) -> None:
        """Make the open episode's folder.

        Args:
            index: The dataset's index.
            episode_id: The name of the episode.
            seed: The seed of the reset.
            instruction: The instruction to the robot.

        Raises:
            InvalidSetup: The id cannot be the name of a folder, or the instruction cannot be stored.
            DatasetError: An episode has this name, or the folder cannot be made.
        """
        check_episode_id(episode_id)
        check_text(instruction, "The instruction")
        if seed is not None and not abs(int(seed)) < MOST_SEED:
            raise InvalidSetup(f"The seed is {seed}; valid are whole numbers below 2 ** 128.")
        self.id = episode_id
        self.info = index.info
        self.state: State = "open"
        self._process = os.getpid()
        self.end: Callable[[str], object] = self.abort
        """Ends the episode when its dataset is closed, given a reason; a thread that adds rows sets its own."""
        self._index = index
        self._folder = index.root / OPEN_FOLDER / episode_id
        self.rows = 0
        """Rows added, the reset observation included."""
        self._buffer = RowBuffer(self.info)
        header = EpisodeHeader(
            id=episode_id,
            seed=None if seed is None else int(seed),
            instruction=instruction,
            started=_now(),
            versions={**self.info.versions, **library_versions()},
        )
        with disk_errors(f"start episode {episode_id!r}", self._folder):
            try:
                self._folder.mkdir(parents=True)
            except FileExistsError as err:
                raise DatasetError(
                    f"Episode {episode_id!r} is already being recorded, or was when its writer died: {self._folder}. "
                    "Resume the dataset to recover or discard it, or choose another id; `rcs data check --repair` puts "
                    "one aside that cannot be read."
                ) from err
            # Checked only now: a writer that finished this id in between has freed the open folder's name.
            if episode_id in index.refresh():
                self._folder.rmdir()
                raise DatasetError(f"There already is an episode {episode_id!r} in {index.root}; choose another id.")
            try:
                self._stream = StreamWriter(self._folder / ROWS_FILE, self.info.stream_schema, header)
            except BaseException:  # a full disk
                remove_tree(self._folder)
                raise
        self._flushed_at = time.monotonic()

    def check(self, row: Mapping[str, Value], sim_state: NDArray[np.float64] | None, *, is_first: bool) -> None:
        """Refuse a row that `add` would refuse; may be called while another thread adds.

        Args:
            row: A value for each feature.
            sim_state: The simulation's state, shape (sim_state_size,).
            is_first: Whether it is the reset observation.

        Raises:
            InvalidSetup: A key, shape, dtype or time is wrong.
        """
        self._buffer.check(row, sim_state, is_first=is_first)

    def add(self, row: Mapping[str, Value], sim_state: NDArray[np.float64] | None = None) -> None:
        """Record one step; the first row is the reset observation.

        Args:
            row: A value for each feature. In the first row, action, executed action and reward are None or left out. A
                `time/*` that was not measured is None.
            sim_state: The simulation's state after the step, shape (sim_state_size,).

        Raises:
            InvalidSetup: A key, shape, dtype or time is wrong; the row is not recorded, and the episode stays open.
            DatasetError: The disk is full or fails; the episode is aborted, and other episodes are as they were.
        """
        self._check_open("add a row")
        self._buffer.add(row, sim_state)
        self.rows += 1
        if self._buffer.is_full or time.monotonic() - self._flushed_at > _FLUSH_AFTER_S:
            self._flush()

    def finish(
        self,
        success: bool | None,
        outcome: Mapping[str, Any] | None = None,
        *,
        instruction: str | None = None,
        timing: Mapping[str, Any] | None = None,
    ) -> EpisodeRecord:
        """Complete the episode and return it.

        Args:
            success: Whether the task was done; None if that is not known.
            outcome: Further facts to keep about how it went: JSON values, numpy numbers and arrays.
            instruction: The instruction that the robot had; None for the instruction given at the start.
            timing: Additions to the timing report that the rows do not show.

        Raises:
            InvalidSetup: There are no rows, the outcome is not JSON, or a text cannot be stored; the episode stays
                open.
            DatasetError: The disk is full or fails, or has fewer rows than were added; the episode is aborted, and
                `recover` can complete it later.
            CorruptEpisode: The rows on the disk are not those that were added; the episode is aborted.
        """
        self._check_open("finish")
        if self.rows == 0:
            raise InvalidSetup(f"Episode {self.id!r} has no rows; add the reset observation first, or discard it.")
        kept, measured = as_json(dict(outcome or {})), as_json(dict(timing or {}))
        if instruction is not None:
            check_text(instruction, "The instruction")
        if not isinstance(success, (bool, np.bool_, type(None))):
            raise InvalidSetup(f"success is {success!r}; valid are True, False and None.")
        self._flush()
        try:
            self._stream.close()
            verdict = None if success is None else bool(success)
            folder = compact(
                self._index,
                self.id,
                success=verdict,
                outcome=kept,
                ended=_now(),
                instruction=instruction,
                timing=measured,
                rows=self.rows,
            )
        except BaseException as err:  # a failing disk, or Ctrl-C
            if self._folder.exists():
                self._mark_aborted(str(err) or type(err).__name__)
            else:
                self.state = "finished"  # only the last sync is missing
            raise
        assert folder is not None, "an episode with rows has a folder"
        self.state = "finished"
        return EpisodeRecord(folder, self.info)

    def discard(self) -> None:
        """Remove the episode with all its rows; harmless after a refused `finish`, an abort or another discard.

        Raises:
            DatasetError: The episode is finished, or the disk fails.
        """
        if self.state == "discarded":
            return
        refuse_fork(self._process, f"discard episode {self.id!r}")
        if self.state == "finished":
            raise DatasetError(f"Episode {self.id!r} is finished and cannot be discarded.")
        self._stream.close()
        with disk_errors(f"discard episode {self.id!r}", self._folder):
            remove_folder(self._folder, new_trash(self._index.root, self.id))
        self.state = "discarded"

    def abort(self, reason: str) -> None:
        """Abort the episode but keep its rows for `recover`; an episode without rows is discarded.

        Args:
            reason: Why, in words; stored beside the rows.

        Raises:
            DatasetError: The episode is finished or discarded, or the disk fails.
        """
        if self.state == "aborted":
            return
        self._check_open("abort")
        if self.rows == 0:
            self.discard()
            return
        if self._buffer.rows:
            self._flush()
        self._mark_aborted(reason)

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        """Abort the episode unless it is finished or discarded."""
        if self.state == "open" and self._process == os.getpid():
            self.abort("left without finish" if kind is None else f"{kind.__name__}: {error}")

    def _flush(self) -> None:
        self._flushed_at = time.monotonic()
        if self._buffer.rows:
            try:
                self._stream.write(self._buffer.take())
            except DatasetError as err:
                self._mark_aborted(str(err))
                raise

    def _mark_aborted(self, reason: str) -> None:
        self.state = "aborted"
        self._stream.close()
        try:
            write_file(self._folder / ABORTED_FILE, sealed({"reason": mended_text(reason)}))
        except OSError as err:
            # On a full disk the reason cannot be stored either; the rows are still there.
            _log.warning("Episode %r is aborted, and the reason could not be stored: %s", self.id, err)

    def _check_open(self, doing: str) -> None:
        if self.state != "open":
            raise DatasetError(f"Cannot {doing}: episode {self.id!r} is {self.state}.")
        refuse_fork(self._process, f"{doing} of episode {self.id!r}")


def refuse_fork(process: int, doing: str) -> None:
    """Refuse what a forked process does with a writer of its parent, with which it shares files and what is buffered.

    Args:
        process: Whose the writer is.
        doing: The refused action, in words.

    Raises:
        DatasetError: This is another process.
    """
    if os.getpid() != process:
        raise DatasetError(
            f"Cannot {doing}: the writer is that of process {process}, and process {os.getpid()} is a fork of it. "
            "Use DatasetWriter.join here."
        )


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")
