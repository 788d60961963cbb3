"""The gateway: whoever does not know the code sees nothing of the page, and the code does not travel in the clear."""

from __future__ import annotations

import http.client
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from rcs.errors import InvalidSetup
from rcs.rollout.interactive import gateway as gateways
from rcs.rollout.interactive.gateway import Gateway

pytestmark = pytest.mark.extras

CODE = "abcd2345"


class Behind(BaseHTTPRequestHandler):
    """Answers with what it was asked."""

    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        body = f"{self.path} {self.headers['Connection']}".encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args: object) -> None: ...  # type: ignore[override]


@pytest.fixture
def behind() -> Iterator[int]:
    """Port of the server behind."""
    with HTTPServer(("127.0.0.1", 0), Behind) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


@pytest.fixture
def gateway(behind: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Gateway]:
    from rcs.teleop import credentials

    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setattr(gateways, "PAUSE", 0.3)
    with Gateway("127.0.0.1", 0, behind=behind, code=CODE, tls=credentials.tls()) as made:
        yield made


def ask(gateway: Gateway, path: str, cookie: str = "") -> tuple[int, str, http.client.HTTPResponse]:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    connection = http.client.HTTPSConnection("127.0.0.1", gateway.port, context=context, timeout=20)
    connection.request("GET", path, headers={"Cookie": cookie, "Connection": "keep-alive"} if cookie else {})
    answer = connection.getresponse()
    return answer.status, answer.read().decode(), answer


def test_the_code_opens_the_page_and_is_then_a_cookie_of_this_site_alone(gateway: Gateway) -> None:
    status, _, answer = ask(gateway, f"/?code={CODE}")
    assert (status, answer.headers["Location"]) == (303, "/")
    cookie = answer.headers["Set-Cookie"]
    for word in ("HttpOnly", "Secure", "SameSite=Strict"):
        assert word in cookie
    cookies = f"other=1; {cookie.partition(';')[0]}"
    assert ask(gateway, "/assets/a.js?b=1", cookies)[:2] == (200, "/assets/a.js?b=1 close")


@pytest.mark.parametrize("cookie", ["", "rcs_code=", "rcs_code=wrong", f"not_rcs_code={CODE}x", f"rcs_code={CODE}1"])
def test_without_the_code_there_is_a_form_and_nothing_else(gateway: Gateway, cookie: str) -> None:
    for path in ("/", "/assets/a.js", "/?other=1"):
        status, body, _ = ask(gateway, path, cookie)
        assert status == 401
        assert 'name="code"' in body
        assert "close" not in body


@pytest.mark.parametrize(
    ("name", "status"),
    [
        ("localhost", 200), ("LOCALHOST:8080", 200), ("127.0.0.1:8080", 200), ("[::1]:8080", 200), ("", 403),
        ("evil.example:8080", 403), ("127.0.0.1.evil.example", 403), ("localhost.evil.example", 403),
        ("192.0.2.1", 403),
    ],
)  # fmt: skip
def test_without_a_code_only_names_that_nobody_else_gives_are_answered(behind: int, name: str, status: int) -> None:
    with Gateway("127.0.0.1", 0, behind=behind) as gateway:
        connection = http.client.HTTPConnection("127.0.0.1", gateway.port, timeout=20)
        connection.request("GET", "/", headers={"Host": name})
        answer = connection.getresponse()
        assert answer.status == status
        assert status == 200 or b"http://localhost" in answer.read()


def test_wrong_codes_are_tried_one_after_the_other(gateway: Gateway) -> None:
    begin = time.monotonic()
    threads = [threading.Thread(target=ask, args=(gateway, f"/?code=wrong{i}")) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert time.monotonic() - begin > 3 * 0.3 - 0.05
    assert ask(gateway, "/?code=wrong")[0] == 403


def test_plain_http_is_told_what_to_do(gateway: Gateway) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", gateway.port, timeout=20)
    connection.request("GET", f"/?code={CODE}")
    answer = connection.getresponse()
    assert answer.status == 400
    assert b"https://" in answer.read()


def test_rubbish_and_silence_harm_nobody(gateway: Gateway, monkeypatch: pytest.MonkeyPatch) -> None:
    with Gateway("127.0.0.1", 0, behind=1) as plain:
        for line, origin in ((b"GET http://[ HTTP/1.1", b"http://localhost"), (b"GET / HTTP/1.1", b"http://[")):
            with socket.create_connection(("127.0.0.1", plain.port), timeout=20) as connection:
                connection.sendall(line + b"\r\nUpgrade: websocket\r\nOrigin: " + origin + b"\r\n\r\n")
                assert connection.recv(1000).startswith(b"HTTP/1.1 400")
    monkeypatch.setattr(gateways, "GREETING", 0.2)
    silent = socket.create_connection(("127.0.0.1", gateway.port))
    for rubbish in (b"\x16\x03\x01rubbish", b"\x00" * 100, b"GET"):
        with socket.create_connection(("127.0.0.1", gateway.port)) as connection:
            connection.sendall(rubbish)
            connection.settimeout(20)
            while connection.recv(1000):
                pass
    silent.settimeout(20)
    assert silent.recv(1) == b""
    silent.close()
    assert ask(gateway, "/", f"rcs_code={CODE}")[0] == 200


def test_a_gateway_may_be_closed_at_once() -> None:
    for _ in range(20):
        Gateway("127.0.0.1", 0, behind=1).close()


def test_a_taken_port_leads_to_the_next_and_a_foreign_address_is_refused(gateway: Gateway) -> None:
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    with Gateway("127.0.0.1", gateway.port, behind=1, code=CODE, tls=tls) as other:
        assert other.port > gateway.port
    with pytest.raises(InvalidSetup, match=r"cannot listen at '192\.0\.2\.1'"):
        Gateway("192.0.2.1", 0, behind=1, code=CODE, tls=tls)
    gateway.close()
    gateway.close()
    assert gateway._loop.is_closed()
