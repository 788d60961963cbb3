"""Serve a policy or a simulator, print the recipe of its environment, show a server's state, and time its answers."""

from __future__ import annotations

import argparse
import json
import logging
import os
import pkgutil
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlagents import __version__
from vlagents.errors import InvalidInput, VlagentsError
from vlagents.observation import Observation
from vlagents.policies import catalogue
from vlagents.policy import Policy
from vlagents.remote import connect
from vlagents.simulators import served

TOKEN = "VLAGENTS_TOKEN"
"""Environment variable with the token: words of a command can be read by everybody on the machine."""
SERVERS = {
    "vla": "vlagents.server:Server",
    "ws": "vlagents.websocket:WebsocketServer",
    "gr00t": "vlagents.other_wires.groot:GrootServer",
    "openvla": "vlagents.other_wires.openvla:OpenvlaServer",
    "vla-eval": "vlagents.other_wires.vla_eval:VlaEvalServer",
}
"""The class of each wire; a module is imported when it is used."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that end a server."""


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = _parser()
    given, more = parser.parse_known_args(words)
    if more and given.act not in (_serve, _simulate):
        parser.error(f"unrecognized arguments: {' '.join(more)}")
    given.more = more
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    try:
        return given.act(given)
    except (VlagentsError, OSError) as error:
        print(f"error: {type(error).__name__}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="vlagents", description=__doc__)
    parser.add_argument("--version", action="version", version=f"vlagents {__version__}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    token = f"a file with the token; without it, the environment variable {TOKEN} holds it"

    serve = _add_server(verbs, "serve", "policy", token)
    serve.add_argument(
        "policy", help=f"its name: {', '.join(catalogue.names())}; or module:Class, also of the current folder"
    )
    serve.add_argument("--checkpoint", default="", help="folder, file, or whatever else the policy is made of")
    serve.add_argument(
        "--settings", default="", help="file that says how the checkpoint's inputs are called; see the README"
    )
    serve.add_argument(
        "--wire",
        choices=tuple(SERVERS),
        default="vla",
        help="TCP and shared memory, openpi's websocket, GR00T's ZeroMQ, OpenVLA's POST /act, or vla-eval's websocket",
    )
    serve.set_defaults(act=_serve)

    simulate = _add_server(verbs, "simulate", "simulator", token)
    simulate.add_argument(
        "simulator", help=f"{', '.join(f'{name}:TASK' for name in served.BUILT_IN)}; or module:Class:task"
    )
    simulate.set_defaults(act=_simulate)

    recipe = verbs.add_parser("recipe", help="print the script that makes an environment for a family of policies")
    recipe.add_argument("family", help=f"its name: {', '.join(catalogue.recipes())}")
    recipe.set_defaults(act=_recipe)

    ping = verbs.add_parser("ping", help="show a server's state, and what its policy needs and gives")
    _add_address(ping, token)
    ping.set_defaults(act=_ping)

    measure = verbs.add_parser("bench", help="measure how long an answer takes")
    _add_address(measure, token)
    measure.add_argument("--calls", type=int, default=200, help="how many answers")
    measure.add_argument(
        "--image",
        action="append",
        default=[],
        metavar="HEIGHTxWIDTH",
        help="a picture of each call; by default those that the policy needs",
    )
    measure.set_defaults(act=_bench)
    return parser


def _add_server(verbs: Any, verb: str, what: str, token: str) -> argparse.ArgumentParser:
    """Add a verb that serves something, and return its parser."""
    parser = verbs.add_parser(
        verb,
        help=f"serve a {what} until Ctrl-C",
        allow_abbrev=False,
        epilog=f"Other options, such as --size 128, are arguments of the {what}: JSON, or text.",
    )
    parser.add_argument("--host", default="127.0.0.1", help="anything but this machine itself needs a token")
    parser.add_argument("--port", type=int, default=None, help="of TCP; by default the wire's own")
    parser.add_argument("--token-file", type=Path, help=token)
    parser.add_argument("--certificate", type=Path, help="file with a certificate, for TLS")
    parser.add_argument("--key", type=Path, help="file with its key")
    return parser


def _add_address(parser: argparse.ArgumentParser, token: str) -> None:
    parser.add_argument("address", help="vla://host:port, vlas://, ws://, wss://, gr00t:// or openvla+http://")
    parser.add_argument("--timeout", type=float, default=5.0, help="how long an answer may take [s]")
    parser.add_argument("--token-file", type=Path, help=token)
    parser.add_argument("--certificate", type=Path, help="that the server's must be signed by")


def _token(given: Any) -> str | None:
    if given.token_file is not None:
        return given.token_file.read_text().strip()
    return os.environ.get(TOKEN)


def _options(words: Sequence[str]) -> dict[str, str]:
    """Return `--name value` and `--name=value` as a dictionary."""
    found: dict[str, str] = {}
    left = list(words)
    while left:
        name, has_value, value = left.pop(0).partition("=")
        if not name.startswith("--") or not (has_value or left):
            raise InvalidInput(f"{name!r} is no option with a value; valid are --name value and --name=value.")
        found[name[2:].replace("-", "_")] = value if has_value else left.pop(0)
    return found


def _serve(given: Any) -> int:
    return _serve_at(catalogue.load(given.policy, given.checkpoint, given.settings, _options(given.more)), given)


def _simulate(given: Any) -> int:
    given.wire = "vla"
    return _serve_at(served.load(given.simulator, _options(given.more)), given)


def _serve_at(policy: Policy, given: Any) -> int:
    server = pkgutil.resolve_name(SERVERS[given.wire])(
        policy, host=given.host, port=given.port, token=_token(given), certificate=given.certificate, key=given.key
    )
    stop = threading.Event()

    def end(*_: object) -> None:
        stop.set()
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)  # the next one ends what does not end by itself

    for number in SIGNALS:
        signal.signal(number, end)
    with server:
        metadata = server.service.metadata
        print(f"Serving {metadata.name} at {server.address}. Ctrl-C ends it.", flush=True)
        stop.wait()
    if server.service.is_stuck:  # Python would wait for threads of the policy's own
        logging.shutdown()
        os._exit(1)
    return 0


def _recipe(given: Any) -> int:
    print(catalogue.recipe(given.family), end="")
    return 0


def _client(given: Any) -> Any:
    """Connect; the time of actions, which some servers do not send, does not matter here."""
    options = {"token": _token(given), "timeout": given.timeout, "certificate": given.certificate}
    return connect(given.address, period=1.0, **options)


def _ping(given: Any) -> int:
    with _client(given) as client:
        metadata = client.metadata()
        print(f"{metadata.name}: chunks of {metadata.horizon} at {metadata.rate:g} Hz, {metadata.size} numbers each")
        for what, parts in (("action", metadata.action), ("state", metadata.state)):
            for part in parts:
                print(f"  {what:<7}{part.name}: {part.size} {part.unit}, {part.meaning}".rstrip(", "))
        for image in metadata.images:
            print(f"  image  {image.name}: {image.height or 'any'} x {image.width or 'any'}")
        if hasattr(client, "ping"):
            for name, value in client.ping().items():
                print(f"  {name}: {value}")
    return 0


def _bench(given: Any) -> int:
    """Print a JSON object with the median and the 99th percentile of a call's time; the first ten do not count."""
    with _client(given) as client:
        metadata = client.metadata()
        random = np.random.default_rng(0)
        sizes = {f"image {i}": _size(text) for i, text in enumerate(given.image)} or {
            image.name: (image.height or 224, image.width or 224) for image in metadata.images
        }
        observation = Observation(
            images={name: random.integers(0, 256, (*size, 3), np.uint8) for name, size in sizes.items()},
            state={part.name: np.zeros(part.size) for part in metadata.state},
            instruction="measure",
            session="bench",
        )
        client.reset("bench", "measure")
        seconds = []
        for _ in range(given.calls + 10):
            begin = time.perf_counter()
            client.infer(observation)
            seconds.append(time.perf_counter() - begin)
        client.forget("bench")
    half, most = 1e3 * np.quantile(seconds[10:], [0.5, 0.99])
    print(json.dumps({"calls": given.calls, "p50_ms": round(float(half), 3), "p99_ms": round(float(most), 3)}))
    return 0


def _size(text: str) -> tuple[int, int]:
    height, _, width = text.partition("x")
    if not (height.isdecimal() and width.isdecimal() and int(height) * int(width)):
        raise InvalidInput(f"An image is {text!r}; valid is HEIGHTxWIDTH, such as 224x224.")
    return int(height), int(width)
