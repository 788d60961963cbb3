"""What a dataset is at a time: its episodes, its history, and what undo would bring back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rcs_data.about import entry_problem
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.info import DatasetInfo


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What the index has of an episode, so that most questions need no other file."""

    id: str
    """The name, unique in the dataset."""
    folder: str
    """The folder's name: the id, or the id and the number of what wrote it."""
    length: int
    """Rows."""
    success: bool | None
    """Whether the task was done; None if that is not known."""
    seed: int | None
    """The seed of the reset."""
    content_hash: str
    """As in `episode.json`."""
    instruction: str | None = None
    """What the robot was asked to do; None for the dataset's instruction."""
    failure: str | None = None
    """Why it failed, as the outcome says."""

    @classmethod
    def of(cls, about: Mapping[str, Any], folder: str, info: DatasetInfo) -> Entry:
        """Return the entry of an episode, given the contents of its `episode.json`."""
        failure = about["outcome"].get("failure")
        return cls(
            id=about["id"],
            folder=folder,
            length=about["length"],
            success=about["success"],
            seed=about["seed"],
            content_hash=about["content_hash"],
            instruction=None if about["instruction"] == info.instruction else about["instruction"],
            failure=failure if isinstance(failure, str) else None,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values, without those that say nothing."""
        short = {name: value for name, value in vars(self).items() if value is not None}
        if self.folder == self.id:
            del short["folder"]
        return short

    @classmethod
    def from_json(cls, values: Any) -> Entry:
        """Build an entry from what `to_json` returned.

        Raises:
            InvalidSetup: A field is missing, unknown or does not make sense.
        """
        if not isinstance(values, dict):
            raise InvalidSetup(f"an episode is {values!r:.80}")
        given: dict[str, Any] = {"success": None, "seed": None, "folder": values.get("id"), **values}
        if problem := entry_problem(given):
            raise InvalidSetup(problem)
        return cls(**given)


@dataclass(frozen=True, kw_only=True)
class Edit:
    """One line of a dataset's history."""

    number: int
    """The number of the edit, from 1; what it wrote has the number in its folder's name."""
    command: str
    """What was done, such as "delete" or "undo"."""
    arguments: dict[str, Any]
    """Its arguments, as JSON values."""
    at: str
    """Wall clock, ISO 8601 in UTC."""
    episodes: int
    """Number of episodes after it."""


@dataclass(frozen=True, kw_only=True)
class Changes:
    """What an edit changes; everything else stays as it is."""

    dropped: tuple[str, ...] = ()
    """Ids of episodes that are gone."""
    written: tuple[Entry, ...] = ()
    """New entries, of new or known ids."""
    relabelled: tuple[str, ...] | None = ()
    """Ids of episodes with another instruction; None for all."""
    instruction: str | None = None
    """Their instruction; None for the dataset's."""
    info: DatasetInfo | None = None
    """What the episodes share from now on; None for the same as before."""

    def to_json(self) -> dict[str, Any]:
        """Return what changes as JSON values."""
        values: dict[str, Any] = {}
        if self.dropped:
            values["drop"] = list(self.dropped)
        if self.written:
            values["write"] = [entry.to_json() for entry in self.written]
        if self.relabelled != ():
            values["relabel"] = None if self.relabelled is None else list(self.relabelled)
            values["instruction"] = self.instruction
        if self.info is not None:
            values["info"] = self.info.to_json()
        return values


@dataclass(frozen=True)
class _Former:
    """What undoing an edit brings back."""

    edit: Edit
    entries: dict[str, Entry | None]
    info: DatasetInfo | None
    added: set[str]
    """Ids of episodes that were recorded since, and are there."""


@dataclass
class State:
    """What a dataset is: the sum of a journal's lines."""

    info: DatasetInfo
    """What the episodes share."""
    episodes: dict[str, Entry] = field(default_factory=dict[str, Entry])
    """The episodes by id."""
    history: list[Edit] = field(default_factory=list[Edit])
    """The edits, oldest first."""
    removed: dict[str, str] = field(default_factory=dict[str, str])
    """Content hashes of episodes that were removed for good, by folder."""
    former: list[_Former] = field(default_factory=list[_Former])
    """What can be undone, oldest first."""

    @property
    def last_number(self) -> int:
        """The number of the last edit; 0 if there was none."""
        return self.history[-1].number if self.history else 0

    def folders(self) -> set[str]:
        """Return the folders of the episodes, and of those that undo can bring back."""
        return {entry.folder for entry in (*self.episodes.values(), *self.former_entries())}

    def former_entries(self) -> list[Entry]:
        """Return the entries of folders that only undo can bring back."""
        kept = {entry.folder for entry in self.episodes.values()}
        entries = (entry for one in self.former for entry in one.entries.values() if entry is not None)
        return list({entry.folder: entry for entry in entries if entry.folder not in kept}.values())

    def undoable(self) -> Edit | None:
        """Return the edit that undo would undo, if there is one."""
        return self.former[-1].edit if self.former else None

    def returning(self) -> list[Entry]:
        """Return the entries that undoing the last edit brings back, and that are not the present ones."""
        entries = self.former[-1].entries if self.former else {}
        return [one for name, one in entries.items() if one is not None and one != self.episodes.get(name)]

    def forget(self) -> None:
        """Give up what undo would bring back; its episodes count as removed."""
        self.removed |= {entry.folder: entry.content_hash for entry in self.former_entries()}
        self.former.clear()

    def refuse_undo(self, root: Path) -> None:
        """Raise if undoing the last edit would lose what was recorded since.

        Raises:
            DatasetError: Rows of another form were recorded since, or episodes of the same ids as those that return.
        """
        last = self.former[-1]
        if last.added and last.info is not None:
            raise DatasetError(
                f"Episodes were recorded into {root} since {last.edit.command!r}, and they do not fit what "
                "the dataset was before. Split them off first, or delete what you do not want."
            )
        if twice := sorted(name for name in last.added if last.entries.get(name) is not None):
            raise DatasetError(
                f"Episodes {', '.join(twice[:5])} were recorded into {root} since {last.edit.command!r}, which undo "
                "would bring back under the same ids. Split them off, and take them out with "
                "DatasetWriter.remove_episode, first."
            )

    def take(self, line: dict[str, Any]) -> None:
        """Take the next line.

        Raises:
            InvalidSetup: The line makes no sense here.
        """
        (kind, value), *more = line.items() or [("", None)]
        takers = {
            "add": self._add, "remove": self._remove, "edit": self._edit,
            "undo": self._undo, "gone": self._gone, "past": self._past,
        }  # fmt: skip
        if more or kind not in takers:
            raise InvalidSetup(f"a line is {line!r:.80}")
        takers[kind](value)

    def _add(self, value: Any) -> None:
        entry = Entry.from_json(value)
        if entry.id in self.episodes:
            raise InvalidSetup(f"episode {entry.id!r} was added twice")
        self.episodes[entry.id] = entry
        if self.former:
            self.former[-1].added.add(entry.id)

    def _remove(self, value: Any) -> None:
        entry = self.episodes.pop(value, None) if isinstance(value, str) else None
        if entry is None:
            raise InvalidSetup(f"{value!r:.80} was removed and not there")
        self.removed[entry.folder] = entry.content_hash
        for one in self.former:
            one.added.discard(entry.id)

    def _edit(self, value: Any) -> None:
        edit, changes = _edit_of(value), _changes_of(value)
        former: dict[str, Entry | None] = {}
        for name in changes.dropped:
            if name not in self.episodes:
                raise InvalidSetup(f"{name!r:.80} was deleted and not there")
            former[name] = self.episodes.pop(name)
        for entry in changes.written:
            former.setdefault(entry.id, self.episodes.get(entry.id))
            self.episodes[entry.id] = entry
        names = changes.relabelled if changes.relabelled is not None else tuple(self.episodes)
        for name in names:
            if name not in self.episodes:
                raise InvalidSetup(f"{name!r:.80} was relabelled and is not there")
            entry = self.episodes[name]
            former.setdefault(name, entry)
            self.episodes[name] = replace(entry, instruction=changes.instruction)
        before = None if changes.info is None else self.info
        self.info = changes.info or self.info
        self.former.append(_Former(edit, former, before, set()))
        self.history.append(replace(edit, episodes=len(self.episodes)))

    def _undo(self, value: Any) -> None:
        edit = _edit_of(value)
        if not self.former:
            raise InvalidSetup("there was nothing to undo")
        undone = self.former.pop()
        for name, entry in undone.entries.items():
            if entry is None:
                self.episodes.pop(name, None)
            else:
                self.episodes[name] = entry
        self.info = undone.info or self.info
        if self.former:  # what came after the later edit came after this one
            self.former[-1].added.update(undone.added)
        self.history.append(replace(edit, episodes=len(self.episodes)))

    def _gone(self, value: Any) -> None:
        if not isinstance(value, list) or len(value) != 2 or not all(isinstance(text, str) for text in value):
            raise InvalidSetup(f"a removed episode is {value!r:.80}")
        self.removed[value[0]] = value[1]

    def _past(self, value: Any) -> None:
        if not isinstance(value, dict) or not isinstance(value.get("episodes"), int):
            raise InvalidSetup(f"a former edit is {value!r:.80}")
        self.history.append(replace(_edit_of(value), episodes=value["episodes"]))


def _changes_of(values: Mapping[str, Any]) -> Changes:
    dropped, relabelled = values.get("drop", []), values.get("relabel", [])
    are_names = all(isinstance(name, str) for name in [*(dropped or []), *(relabelled or [])])
    instruction: Any = values.get("instruction")
    if not are_names or not isinstance(dropped, list) or not isinstance(instruction, str | None):
        raise InvalidSetup(f"an edit is {values!r:.200}")
    return Changes(
        dropped=tuple(dropped),
        written=tuple(map(Entry.from_json, values.get("write", []))),
        relabelled=None if relabelled is None else tuple(relabelled),
        instruction=instruction,
        info=DatasetInfo.from_json(values["info"]) if "info" in values else None,
    )


def _edit_of(values: Any) -> Edit:
    given = values if isinstance(values, dict) else {}
    number, command, arguments, at = (given.get(name) for name in ("number", "command", "arguments", "at"))
    is_number = type(number) is int and number > 0
    if not (is_number and isinstance(command, str) and isinstance(arguments, dict) and isinstance(at, str)):
        raise InvalidSetup(f"an edit is {values!r:.200}")
    assert type(number) is int
    return Edit(number=number, command=command, arguments=arguments, at=at, episodes=0)
