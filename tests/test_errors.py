from __future__ import annotations

import copy
import pickle
from typing import Any

import pytest

from rcs.errors import RcsError, UnknownName


def all_kinds(kind: type[RcsError]) -> list[type[RcsError]]:
    """Return an error and everything derived from it, wherever it is defined."""
    return [kind, *(one for child in kind.__subclasses__() for one in all_kinds(child))]


KINDS = all_kinds(RcsError)


def make(kind: type[RcsError]) -> RcsError:
    return UnknownName("robot", "fr4", ["fr3", "ur5e"], hint="Look.") if kind is UnknownName else kind("what is wrong")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("send", [lambda error: pickle.loads(pickle.dumps(error)), copy.copy, copy.deepcopy])
def test_every_error_can_be_sent_to_another_process(kind: type[RcsError], send: Any) -> None:
    error = make(kind)
    error.add_note("It happened in copy 3.")
    vars(error)["copy"] = 3
    again = send(error)
    assert type(again) is kind
    assert str(again) == str(error)
    assert again.args == error.args
    assert vars(again) == vars(error)
    assert again.__notes__ == ["It happened in copy 3."]


def test_an_unknown_name_says_the_nearest_and_all_that_are_known() -> None:
    message = str(make(UnknownName))
    assert message == "There is no robot named 'fr4'. Did you mean 'fr3'? Known: fr3, ur5e. Look."


def test_there_are_at_most_thirteen_kinds_of_errors() -> None:
    assert len(KINDS) <= 13, "twelve, and their parent"
