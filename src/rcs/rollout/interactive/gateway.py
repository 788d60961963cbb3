"""A gateway to a page of this machine; for other machines it is over TLS, and only with the code.

Asynchronous, on a thread of its own. A browser gives the code once, in the address or in a form, and keeps it in a
cookie that no other site can use. The rest goes to a server behind as it is, one request per connection. Pages of other
sites, which may ask a browser to connect to any address, get no stream; without a code, also no other name of this
machine is answered, for another site may have given it.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import re
import socket
import ssl
import threading
from collections.abc import Mapping
from urllib.parse import parse_qs, urlsplit

from rcs_data.files.closing import Closing

from rcs.errors import InvalidSetup

GREETING = 5.0
"""Time in which a browser says what it wants [s]."""
PAUSE = 1.0
"""Pause after a wrong code, for all who try [s]."""
LARGEST = 1 << 16
"""Largest head of a request, and most bytes that are passed on at once."""
PEERS = 128
"""Most connections at a time."""
PORTS = 100
"""Ports that are tried from the given one on."""
TLS = 0x16
"""First byte of a client that speaks TLS."""
COOKIE = "rcs_code"

_FORM = b"""<!doctype html><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Robot Control Stack</title><form><label>Code that the program shows: <input name="code" autofocus></label>
<button>Go on</button></form>"""


class Gateway(Closing):
    """Passes browsers on to servers of this machine."""

    def __init__(
        self,
        host: str,
        port: int,
        *,
        behind: int,
        routes: Mapping[str, int] | None = None,
        code: str | None = None,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        """Listen.

        Args:
            host: Address of this machine, or 0.0.0.0 for all.
            port: Port, or the next one that is free; 0 for any.
            behind: Port of the server behind, at 127.0.0.1.
            routes: Ports of other servers there, by path.
            code: The code; None to ask for none, where only this machine reaches the address.
            tls: Settings with the certificate; None for plain HTTP, likewise.

        Raises:
            InvalidSetup: This machine cannot listen at the address, or no port is free.
        """
        self._host = host.lower()
        self._behind, self._routes, self._code, self._tls = behind, dict(routes or {}), code, tls
        self._socket = _listen(host, port)
        self.port: int = self._socket.getsockname()[1]
        """Port at which it listens."""
        self._loop = asyncio.new_event_loop()
        self._trying = asyncio.Lock()
        self._accepting = self._loop.create_task(self._accept())
        self._thread = threading.Thread(target=self._run, name="rcs gateway", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all connections. Closing twice is harmless."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._accepting.cancel)
            self._thread.join()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._accepting)
        except asyncio.CancelledError:
            pass
        finally:
            self._socket.close()
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())
            self._loop.close()

    async def _accept(self) -> None:
        peers: set[asyncio.Task[None]] = set()
        try:
            while True:
                connection, _ = await self._loop.sock_accept(self._socket)
                if len(peers) >= PEERS:
                    connection.close()
                    continue
                connection.setblocking(False)
                task = self._loop.create_task(self._attend(connection))
                peers.add(task)
                task.add_done_callback(peers.discard)
        finally:
            for task in peers:
                task.cancel()
            await asyncio.gather(*peers, return_exceptions=True)

    async def _attend(self, connection: socket.socket) -> None:
        """Serve one connection."""
        is_ours = True
        try:
            async with asyncio.timeout(GREETING):
                if self._tls is not None and await self._peek(connection) != TLS:
                    await self._loop.sock_recv(connection, LARGEST)  # what is unread would reset the connection
                    words = b"This port speaks TLS. Open the same address with https:// in front.\n"
                    await self._loop.sock_sendall(connection, _answer("400 Bad Request", words, kind="text/plain"))
                    return
                reader = asyncio.StreamReader(LARGEST)
                protocol = asyncio.StreamReaderProtocol(reader)
                is_ours = False  # from here on, the transport's
                transport, _ = await self._loop.connect_accepted_socket(lambda: protocol, connection, ssl=self._tls)
                writer = asyncio.StreamWriter(transport, protocol, reader, self._loop)
                head = await reader.readuntil(b"\r\n\r\n")
            try:
                path, answer = await self._answer_to(head)
                if answer is None:
                    await self._pass_on(self._routes.get(path, self._behind), head, reader, writer)
                else:
                    writer.write(answer)
                    await writer.drain()
            finally:
                writer.close()
                await writer.wait_closed()
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            return  # anybody may send rubbish to a port
        finally:
            if is_ours:
                connection.close()

    async def _peek(self, connection: socket.socket) -> int | None:
        """Return the first byte, which stays to be read; None if there is none."""
        is_readable = self._loop.create_future()
        self._loop.add_reader(connection, lambda: is_readable.done() or is_readable.set_result(None))
        try:
            await is_readable
        finally:
            self._loop.remove_reader(connection)
        return next(iter(connection.recv(1, socket.MSG_PEEK)), None)

    async def _answer_to(self, head: bytes) -> tuple[str, bytes | None]:
        """Return the path of a request, and the answer if it is not passed on."""
        line, _, fields = head.decode("latin-1").partition("\r\n")
        origin, host = _field(fields, "origin"), _field(fields, "host")
        try:
            address, site = urlsplit(line.split(" ")[1] if line.count(" ") == 2 else "/"), urlsplit(origin).netloc
        except ValueError:
            return "/", _answer("400 Bad Request", b"This is no address.\n", kind="text/plain")
        if _field(fields, "upgrade") and origin and site.lower() != host.lower():
            return address.path, _answer("403 Forbidden", b"Another site has no business here.\n", kind="text/plain")
        if self._code is None:
            words = b"This name is not the program's; open the address that it shows, at http://localhost.\n"
            return address.path, None if self._is_own(host) else _answer("403 Forbidden", words, kind="text/plain")
        given = parse_qs(address.query).get("code")
        if given is not None and address.path == "/":
            if not self._is_code(given[0]):
                async with self._trying:
                    await asyncio.sleep(PAUSE)
                words = b"<p>This is not the code that the program shows.</p>"
                return address.path, _answer("403 Forbidden", words + _FORM)
            cookie = f"Set-Cookie: {COOKIE}={self._code}; HttpOnly; Secure; SameSite=Strict; Path=/"
            return address.path, _answer("303 See Other", b"", "Location: /", cookie)
        found = re.search(rf"(?:^|[; ]){COOKIE}=([^;]*)", _field(fields, "cookie"))
        is_known = found is not None and self._is_code(found[1])
        return address.path, None if is_known else _answer("401 Unauthorized", _FORM)

    def _is_own(self, host: str) -> bool:
        """Return whether a header `Host` is a name of this machine that nobody else decides upon."""
        name = re.sub(r":\d*$", "", host).strip("[]").lower()
        try:
            return name in ("localhost", self._host) or ipaddress.ip_address(name).is_loopback
        except ValueError:
            return False

    def _is_code(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), str(self._code).encode())

    async def _pass_on(
        self, port: int, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Pass a request on to a port, and everything that follows in both directions, until one side ends."""
        if not re.search(rb"^upgrade:", head, re.IGNORECASE | re.MULTILINE):
            head = re.sub(rb"(?im)^connection:[^\r\n]*", b"Connection: close", head)
        inner, outer = await asyncio.open_connection("127.0.0.1", port)
        try:
            outer.write(head)
            ways = [asyncio.create_task(_copy(reader, outer)), asyncio.create_task(_copy(inner, writer))]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)
        finally:
            outer.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(LARGEST):
        writer.write(data)
        await writer.drain()


def _field(fields: str, name: str) -> str:
    """Return the value of a header; empty if there is none."""
    found = re.search(rf"^{name}:[ \t]*([^\r\n]*?)[ \t]*\r?$", fields, re.IGNORECASE | re.MULTILINE)
    return "" if found is None else found[1]


def _answer(status: str, body: bytes, *fields: str, kind: str = "text/html; charset=utf-8") -> bytes:
    lines = [
        f"HTTP/1.1 {status}", f"Content-Type: {kind}", f"Content-Length: {len(body)}", "Connection: close",
        "Cache-Control: no-store", "X-Content-Type-Options: nosniff", *fields,
    ]  # fmt: skip
    return "\r\n".join([*lines, "", ""]).encode() + body


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    last: OSError | None = None
    for number in range(port, min(port + PORTS, 65536) if port else 1):
        try:
            found = socket.create_server((host, number), family=family)
        except OSError as err:
            last = err
            continue
        found.setblocking(False)
        return found
    raise InvalidSetup(f"This machine cannot listen at {host!r}, port {port} and those after it: {last}.") from last
