"""A policy behind any wire: admission by token, sessions apart by connection, and one call at a time."""

from __future__ import annotations

import hmac
import itertools
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from vlagents.chunk import Chunk
from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    InvalidInput,
    PolicyFailed,
    Unauthorized,
    VlagentsError,
    as_failure,
)
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policy import Policy
from vlagents.record import read
from vlagents.wire.calls import VERSION, Call, chunk_to_values, observation_from_values
from vlagents.wire.link import Deadline

_log = logging.getLogger(__name__)

MOST_SESSIONS = 256
"""Sessions of one connection."""
LONGEST_WAIT = 60.0
"""Longest wait of a call for the policy, if the client names none [s]."""
LEAVING = 1.0
"""Longest wait for calls in progress when a server ends [s]."""


@dataclass(eq=False)
class Caller:
    """One connection, as the service knows it."""

    name: str
    """Its own address, for the log."""
    is_known: bool = False
    """True once it has sent the right token."""
    number: int = field(default_factory=itertools.count().__next__, init=False)
    sessions: set[str] = field(default_factory=set, init=False)


@dataclass(eq=False)
class _Waiting:
    """An observation that waits for its actions."""

    observation: Observation
    begun: float = 0.0
    """Time at which the policy began with it [s]; 0 before."""
    answer: object = None
    error: Exception | None = None


class Service:
    """Answers calls with a policy.

    Sessions of one caller are not those of another, even if they have the same name: the calls and the end of one do
    not affect any other. One thread at a time calls the policy; a policy that has `infer_batch` answers all waiting
    observations at once.
    """

    def __init__(self, policy: Policy, *, token: str | None = None) -> None:
        """Serve a policy.

        Args:
            policy: It is closed with the service.
            token: The secret that callers must know; None for none.

        Raises:
            InvalidInput: The token is empty.
        """
        if token is not None and not token:
            raise InvalidInput("The token is empty; valid is a str that cannot be guessed, or None.")
        self._policy = policy
        self._token = token
        self.metadata: Metadata = policy.metadata()
        """The needs and the answers of the policy."""
        self._is_batched = type(policy).infer_batch is not Policy.infer_batch
        self._turn = threading.Lock()
        self._waiting: dict[_Waiting, None] = {}
        self._started = time.monotonic()
        self._answered = 0
        self._is_closed = False
        self.is_stuck = False
        """True if the policy was still in a call when this was closed."""

    @property
    def has_token(self) -> bool:
        """True if callers must know a token."""
        return self._token is not None

    def admit(self, caller: Caller, token: object) -> None:
        """Admit a caller that knows the token.

        Raises:
            Unauthorized: It does not know it.
        """
        if self._token is not None:
            given = token if isinstance(token, str) else ""
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                _log.warning("%s has no valid token and was refused", caller.name)
                raise Unauthorized("The token is missing or wrong.")
        caller.is_known = True

    def answer(self, caller: Caller, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a call, which may be an error.

        Raises:
            BadMessage: The values are no call.
            Unauthorized: The caller does not know the token.
        """
        if not isinstance(values.get("call"), str):
            raise BadMessage("This is no call.")
        number = values.get("id")
        if not isinstance(number, int):
            raise BadMessage("A call has no number.")
        try:
            return {"id": number, **self._answer(caller, values)}
        except (BadMessage, Unauthorized):
            raise
        except Exception as error:  # noqa: BLE001  the caller gets whatever a policy raises
            return {"id": number, "error": self.failure(caller, error)}

    def failure(self, caller: Caller, error: Exception) -> dict[str, str]:
        """Return an error as a wire carries it; one that was not raised on purpose goes to the log, with its trace."""
        if not isinstance(error, VlagentsError):
            _log.error("The policy failed to answer %s", caller.name, exc_info=error)
        return as_failure(error)

    def health(self) -> dict[str, Any]:
        """Return version, running time and number of answers."""
        from vlagents import __version__

        return {
            "policy": self.metadata.name,
            "version": __version__,
            "wire": VERSION,
            "seconds": round(time.monotonic() - self._started, 3),
            "answered": self._answered,
        }

    def infer(self, caller: Caller, observation: Observation, within: float | None = None) -> dict[str, Any]:
        """Return the policy's chunk for an observation of a caller, as plain values, with the time of each part.

        Raises:
            InvalidInput: The policy returned no chunk, or one of another size.
        """
        own = self._own(caller, observation.session)
        begin = time.perf_counter()
        asked = _Waiting(observation.of_session(own))
        self._waiting[asked] = None
        try:
            self._in_turn(lambda: self._answer_waiting(asked), within)
        finally:
            self._waiting.pop(asked, None)  # if it has waited too long
        waiting, working = asked.begun - begin, time.perf_counter() - asked.begun
        if asked.error is not None:
            try:
                if isinstance(asked.error, (BadMessage, Unauthorized)):  # as in `_in_turn`
                    raise PolicyFailed(f"{type(asked.error).__name__}: {asked.error}") from asked.error
                raise asked.error
            finally:
                asked.error = None  # or error and observation would keep each other
        chunk = asked.answer
        if not isinstance(chunk, Chunk):
            given = "None" if chunk is None else type(chunk).__name__
            text = f"`infer` of the policy {self.metadata.name!r} returned {given}; valid is "
            text += "vlagents.Chunk(actions, period, time)."
            _log.error("%s", text)
            raise InvalidInput(text)
        if chunk.actions.shape[1] != self.metadata.size and self.metadata.action:
            raise InvalidInput(
                f"The policy gave actions of {chunk.actions.shape[1]} numbers; its metadata says {self.metadata.size}."
            )
        self._answered += 1
        values = chunk_to_values(chunk)
        info = {**values["info"], "wait_ms": 1e3 * waiting, "infer_ms": 1e3 * working}
        return {**values, "time": float(observation.time), "info": info}

    def reset(self, caller: Caller, session: str, instruction: str, seed: int | None, within: float | None) -> None:
        """Begin an episode in one of a caller's sessions."""
        own = self._own(caller, session)
        self._in_turn(lambda: self._policy.reset(own, instruction, seed=seed), within)

    def forget(self, caller: Caller, session: str | None = None) -> None:
        """Forget one session of a caller, or all of them when it leaves."""
        names = [session] if session is not None else list(caller.sessions)
        for name in names:
            if name in caller.sessions:
                caller.sessions.discard(name)
                own = f"{caller.number}/{name}"
                try:
                    self._in_turn(lambda own=own: self._policy.forget(own), LONGEST_WAIT)
                except Exception:  # noqa: BLE001  the others' sessions must still be forgotten
                    _log.exception("The policy could not forget session %r of %s", name, caller.name)

    def close(self) -> None:
        """Close the policy, after the call that it is in. A second call does nothing.

        A policy that has not answered that call within `LEAVING` seconds is not closed, and `is_stuck` says so.
        """
        if self._is_closed:
            return
        self._is_closed = True
        if not self._turn.acquire(timeout=LEAVING):
            self.is_stuck = True
            _log.warning("The policy %r still works on a call, and is left without being closed", self.metadata.name)
            return
        try:
            self._policy.close()
        finally:
            self._turn.release()

    def _answer(self, caller: Caller, values: Mapping[str, Any]) -> dict[str, Any]:
        call = read(Call, values)
        if call.call == "hello":
            return self._hello(caller, call)
        if not caller.is_known:
            raise Unauthorized("A connection begins with hello.")
        if call.call == "infer":
            return {"chunk": self.infer(caller, observation_from_values(call.observation), call.within)}
        if call.call == "reset":
            self.reset(caller, call.session, call.instruction, call.seed, call.within)
            return {}
        if call.call == "forget":
            self.forget(caller, call.session)
            return {}
        if call.call == "ping":
            return {"health": self.health()}
        if call.call in self._policy.calls:
            return self._in_turn(lambda: self._policy.calls[call.call](values), call.within)
        known = ", ".join(["hello", "reset", "infer", "forget", "ping", *self._policy.calls])
        raise InvalidInput(f"There is no call {call.call!r:.80}; valid: {known}.")

    def _hello(self, caller: Caller, call: Call) -> dict[str, Any]:
        if call.version != VERSION:
            raise BadMessage(f"The other side speaks version {call.version!r:.40}; this server speaks {VERSION}.")
        self.admit(caller, call.token)
        return {"metadata": self.metadata.to_dict(), "health": self.health()}

    def _own(self, caller: Caller, session: str) -> str:
        """Return the unique name of a caller's session."""
        if session not in caller.sessions and len(caller.sessions) >= MOST_SESSIONS:
            raise InvalidInput(
                f"A connection has up to {MOST_SESSIONS} sessions; `forget` one that does not come back."
            )
        if len(session) > 200:
            raise InvalidInput("The name of a session has more than 200 characters.")
        caller.sessions.add(session)
        return f"{caller.number}/{session}"

    def _answer_waiting(self, asked: _Waiting) -> None:
        """Call the policy with one observation, or with all that wait if it can."""
        if asked.begun:
            return  # in the turn of another call
        together = list(self._waiting) if self._is_batched else [asked]
        for each in together:
            self._waiting.pop(each, None)
            each.begun = time.perf_counter()
        if len(together) == 1:
            asked.answer = self._policy.infer(asked.observation)
            return
        try:
            answers = self._policy.infer_batch([each.observation for each in together])
            for each, answer in zip(together, answers, strict=True):
                each.answer = answer
            return
        except Exception:  # noqa: BLE001  one by one shows which observation fails
            _log.exception("The policy failed to answer %d observations at once", len(together))
        for each in together:
            try:
                each.answer = self._policy.infer(each.observation)
            except Exception as error:  # noqa: BLE001  raised in the call that waits for it
                each.error = error

    def _in_turn(self, act: Callable[[], Any], within: float | None) -> Any:
        wait = LONGEST_WAIT if within is None else min(within, LONGEST_WAIT)
        if not self._turn.acquire(timeout=wait):
            raise Deadline(wait, "The policy, which is busy with other calls,").exceeded()
        try:
            if self._is_closed:
                raise ConnectionLost("The server is closing.")
            return act()
        except (BadMessage, Unauthorized) as error:  # of a server that the policy asks: the caller did nothing wrong
            raise PolicyFailed(f"{type(error).__name__}: {error}") from error
        finally:
            self._turn.release()
