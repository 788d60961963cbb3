"""A factory of agents for a policy at an address; it has no connection and can be pickled."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rcs.envs.env import Env
from rcs.errors import InvalidSetup, RcsError
from rcs.policy.agent import ChunkAgent
from rcs.policy.execution import Execution
from rcs.policy.interface import vlagents

if TYPE_CHECKING:
    from vlagents import Metadata

TOKEN = "VLAGENTS_TOKEN"
"""Environment variable with the token of the server."""


@dataclass(frozen=True, kw_only=True)
class ServedPolicy:
    """A policy behind an address, and how its chunks are executed. Called with an environment, it makes an agent."""

    address: str
    """`vla://host:port`, `vlas://`, `unix://`, `ws://` or `wss://`."""
    execution: Execution = field(default_factory=Execution)
    """Options of the execution of its chunks."""
    instruction: str | None = None
    """The instruction; None for the environment's."""
    timeout: float = 5.0
    """Longest duration of an answer [s]."""
    certificate: str | None = None
    """File with the certificate that the server's must be signed by."""
    described_in: str | None = None
    """JSON file with the policy's metadata, as `Metadata.to_dict` has them, for `ws://` servers that do not send them,
    such as openpi's."""

    @property
    def name(self) -> str:
        """The address."""
        return self.address

    def connect(self) -> Any:
        """Return a client, a policy of vlagents; the token is that of the environment variable `VLAGENTS_TOKEN`.

        Raises:
            MissingDependency: vlagents is not installed.
            InvalidSetup: The address is invalid or takes no metadata, or the file with them is wrong.
            RcsError: There is no server, it does not answer, or it requires another token.
        """
        v = vlagents()
        if self.described_in is not None and not self.address.startswith(("ws://", "wss://")):
            raise InvalidSetup(f"{self.address} sends its own metadata; described_in is for ws:// and wss://.")
        try:
            options = {} if self.described_in is None else {"metadata": _described(Path(self.described_in), v)}
            return v.connect(
                self.address,
                token=os.environ.get(TOKEN),
                timeout=self.timeout,
                certificate=self.certificate,
                **options,
            )
        except v.InvalidInput as err:
            raise InvalidSetup(str(err)) from err
        except (v.VlagentsError, OSError) as err:
            raise RcsError(f"{type(err).__name__}: {err}") from err

    def metadata(self) -> Metadata:
        """Connect, and return the metadata of the policy.

        Raises:
            RcsError: There is no policy; see `connect`.
        """
        with self.connect() as client:
            return client.metadata()

    def __call__(self, env: Env) -> ChunkAgent:
        """Connect, and return an agent for an environment.

        Raises:
            InvalidSetup: Policy and environment do not fit; the message has all differences.
            RcsError: There is no policy; see `connect`.
        """
        client = self.connect()
        try:
            return ChunkAgent(env, client, execution=self.execution, instruction=self.instruction)
        except BaseException:
            client.close()
            raise


def _described(path: Path, v: Any) -> Metadata:
    try:
        return v.Metadata.from_dict(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, RecursionError) as err:
        raise InvalidSetup(f"{path} has no metadata of a policy: {err}") from err


def agent_at(address: str, env: Env) -> ChunkAgent:
    """Return the agent of a policy at an address, with the usual execution."""
    return ServedPolicy(address=address)(env)
