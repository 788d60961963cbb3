"""Times of pictures from a network are right, whatever the camera's clock does, and a refusal is told as what it is."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import pytest

from rcs.devices import CameraMode
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.pictures import READ_LIMIT, HttpPictures, Picture

HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=x\r\n\r\n"


def first_picture(pictures: HttpPictures, server: socket.socket, stamp: float) -> Picture:
    """Connect, and return the first picture, which has a time on the camera's clock."""

    def answer() -> None:
        connection, _ = server.accept()
        with connection:
            connection.recv(4096)
            part = f"--x\r\nContent-Length: 4\r\nX-Timestamp: {stamp}\r\n\r\njpeg"
            connection.sendall(HEAD + part.encode())
            connection.recv(4096)  # until it is closed there

    thread = threading.Thread(target=answer)
    thread.start()
    pictures.open()
    picture = pictures.newest()
    pictures.close()
    thread.join()
    return picture


def test_a_clock_that_begins_anew_after_its_last_time_is_noticed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        pictures = HttpPictures(f"http://127.0.0.1:{server.getsockname()[1]}/", CameraMode(320, 240, 30.0, False))
        first = first_picture(pictures, server, 5.0)
        time.sleep(1.5 * READ_LIMIT)
        begin = time.monotonic()
        again = first_picture(pictures, server, 5.1)
        assert begin <= again.time <= time.monotonic(), "it is not as old as the last one"
        assert again.time > first.time
        clock = pictures.clock
        first_picture(pictures, server, 5.1 + time.monotonic() - again.time)
        assert pictures.clock is clock, "one that goes on keeps its fit"


@pytest.mark.parametrize(
    ("status", "kind"), [("400 Bad Request", InvalidSetup), ("404 Not Found", InvalidSetup), ("503 Busy", DeviceFault)]
)
def test_a_mode_or_camera_that_is_not_there_is_invalid_and_another_refusal_a_fault(
    status: str, kind: type[Exception]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(f"HTTP/1.0 {status}\r\nX-Reason: it has 640x480 at 30\r\n\r\n".encode())

        thread = threading.Thread(target=answer)
        thread.start()
        mode = CameraMode(320, 240, 30.0, False)
        pictures = HttpPictures(f"http://127.0.0.1:{server.getsockname()[1]}/", mode)
        with pytest.raises(kind, match=f"{status}.*it has 640x480 at 30"):
            pictures.open()
        pictures.close()
        thread.join()


def test_a_clock_that_is_set_back_is_fitted_anew() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        pictures = HttpPictures(f"http://127.0.0.1:{server.getsockname()[1]}/", CameraMode(320, 240, 30.0, False))
        goes_on = threading.Event()

        def answer() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(4096)
                first, second = (f"--x\r\nContent-Length: 4\r\nX-Timestamp: {at}\r\n\r\njpeg" for at in (100.0, 99.5))
                connection.sendall(HEAD + first.encode())
                goes_on.wait(20.0)
                connection.sendall(second.encode())
                connection.recv(4096)  # until it is closed there

        thread = threading.Thread(target=answer)
        thread.start()
        pictures.open()
        pictures.newest()
        goes_on.set()
        with pytest.raises(DeviceFault, match=r"back to 99\.500 s"):
            pictures.newest()
        pictures.close()
        thread.join()
        time.sleep(0.6)
        begin = time.monotonic()
        assert first_picture(pictures, server, 100.05).time >= begin, "it is not as old as the step of the clock"


def test_bytes_that_are_no_picture_end_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.hardware.pictures.FIRST_LIMIT", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server:
        is_over = threading.Event()

        def answer() -> None:
            connection, _ = server.accept()
            with connection, contextlib.suppress(OSError):  # it may be closed there meanwhile
                connection.recv(4096)
                connection.sendall(HEAD)
                end = time.monotonic() + 5.0  # else there would be bytes without end
                while not is_over.wait(5e-4) and time.monotonic() < end:
                    connection.sendall(b"x" * 1000)

        thread = threading.Thread(target=answer)
        thread.start()
        pictures = HttpPictures(f"http://127.0.0.1:{server.getsockname()[1]}/", CameraMode(320, 240, 30.0, False))
        pictures.open()
        begin = time.monotonic()
        with pytest.raises(DeviceFault, match="in time"):
            pictures.newest()
        assert time.monotonic() - begin < 3.0
        is_over.set()
        pictures.close()
        thread.join()


@pytest.mark.parametrize("url", ["http://camera:99999/x", "http://camera:abc/x", "http://[::1/x", "rtsp://camera/x"])
def test_an_address_that_is_none_is_refused_with_what_is_valid(url: str) -> None:
    with pytest.raises(InvalidSetup, match="http://HOST:PORT/PATH"):
        HttpPictures(url, CameraMode(320, 240, 30.0, False))
