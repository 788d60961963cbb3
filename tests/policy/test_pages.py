"""A page in a real browser, and policies that are served on the same machine without a token."""

from __future__ import annotations

import http.server
import json
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from vlagents import Chunk, Metadata, Observation, PartSpec, Policy, Server, connect
from vlagents.other_wires.openvla import OpenvlaServer
from vlagents.websocket import WebsocketServer

pytestmark = pytest.mark.browser

ACT = {"image": {"__numpy__": "AAAA", "dtype": "|u1", "shape": [1, 1, 3]}, "instruction": "pick"}
REACH = """
new Promise(done => {
  const socket = new WebSocket('ws://127.0.0.1:%d');
  socket.binaryType = 'arraybuffer';
  socket.onopen = () => socket.send(new Uint8Array([0x81, 0xa6, 0x70, 0x72, 0x6f, 0x6d, 0x70, 0x74, 0xa1, 0x61]));
  let count = 0;
  socket.onmessage = () => { if (++count == 2) done('answered'); };  // the first greets
  socket.onerror = () => done('refused');
})
"""
"""Sends the message {"prompt": "a"}."""
FETCH = "fetch('http://127.0.0.1:%d%s', {method: 'POST', mode: 'no-cors', body: %s}).then(x => x.type, x => 'failed')"


class Counting(Policy):
    """Counts how often it was asked."""

    def __init__(self) -> None:
        self.asked = 0

    def metadata(self) -> Metadata:
        return Metadata(name="counting", action=(PartSpec("joints", 2),), rate=10.0)

    def infer(self, observation: Observation) -> Chunk:
        self.asked += 1
        return Chunk(np.zeros((1, 2)), 0.1)


class Page(http.server.BaseHTTPRequestHandler):
    """A page of another origin."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>page</title>")

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        pass


@pytest.fixture
def page() -> Iterator[str]:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        thread.join()


def test_a_page_reaches_no_policy_and_other_clients_do(chromium: Any, page: str) -> None:
    with ExitStack() as opened:
        servers = [opened.enter_context(kind(Counting(), port=0)) for kind in (WebsocketServer, OpenvlaServer, Server)]
        websocket, openvla, ours = servers
        chromium.open(page)
        assert chromium.run(REACH % websocket.address.port) == "refused"
        chromium.run(FETCH % (openvla.address.port, "/act", json.dumps(json.dumps(ACT))))
        assert chromium.run(FETCH % (ours.address.port, "/", "'VLA1'")) == "failed"
        assert [server.service._policy.asked for server in servers] == [0, 0, 0]
        for server in (websocket, ours):
            opened.enter_context(connect(str(server.address))).infer(Observation())
        assert [server.service._policy.asked for server in servers] == [1, 0, 1]
