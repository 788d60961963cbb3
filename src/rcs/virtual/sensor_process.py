"""The process that draws the cameras and tactile sensors of a virtual world and serves them over HTTP.

It reads lines of JSON: first what to draw, then faults; it ends with its input. A client asks for
`/NAME?resolution=640x480&fps=30` and gets JPEGs without end, each with the moment that it shows, on the sensor's own
clock; with `&format=rgbd`, pixels and depth instead, as `rcs.hardware.realsense_network` reads them. `/NAME?about` says
as JSON what a camera is.
"""

from __future__ import annotations

import json
import random
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import simplejpeg

from rcs.envs.assemble import compose
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.errors import RcsError
from rcs.hardware.realsense_network import RGB, RGBD
from rcs.robots.camera import describe
from rcs.setups.make import resolve
from rcs.sim.camera import SimCameras
from rcs.sim.optics import Optics
from rcs.sim.tactile import SimTactile
from rcs.sim.world import World
from rcs.spatial import Intrinsics
from rcs.virtual.sensors import LATENCY, SharedState, device_time, serial_of

QUALITY = 95
"""Quality of JPEGs, without subsampling of colours."""
MOST_WAITING, MOST_BYTES = 256, 256 << 20
"""Number and size of pictures that a stream keeps for later sending; older ones are dropped."""
JPEG = "jpeg"
"""Format of pictures that are not asked for as pixels."""
BOUNDARY = "picture"


class Sensor:
    """A camera or tactile sensor with its faults."""

    def __init__(self, name: str, modes: Mapping[tuple[int, int], tuple[int, ...]]) -> None:
        self.name = name
        self.modes = modes
        self.frozen_until = self.unplugged_until = 0.0
        self.delay = self.drop = 0.0
        self.is_black = self.is_torn = False
        self.shows = name
        self.plugs = 0
        """Number of times that it was unplugged or exchanged, which ends all streams before."""

    def tell(self, fault: str, value: Any) -> None:
        """Apply a fault."""
        now = time.monotonic()
        if fault == "freeze":
            self.frozen_until = now + value
        elif fault == "unplug":
            self.unplugged_until = now + value
            self.plugs += 1
        elif fault == "swap":
            self.shows = value
            self.plugs += 1
        elif fault == "delay":
            self.delay = 1e-3 * value
        elif fault == "drop":
            self.drop = value
        elif fault == "black":
            self.is_black = True
        elif fault == "tear":
            self.is_torn = True
        else:
            self.plugs += self.shows != self.name
            self.frozen_until = self.unplugged_until = self.delay = self.drop = 0.0
            self.is_black = self.is_torn = False
            self.shows = self.name


class Stream:
    """The pictures that one client gets: those of a sensor, of one size, rate and format."""

    def __init__(self, sensor: Sensor, size: tuple[int, int], fps: float, format: str) -> None:  # noqa: A002
        self.sensor, self.size, self.fps, self.format = sensor, size, fps, format
        self.plugs = sensor.plugs
        self.tick = int(time.monotonic() * fps)
        most = MOST_WAITING if format == JPEG else min(MOST_WAITING, MOST_BYTES // (5 * size[0] * size[1]))
        self.waiting: deque[tuple[float, float, bytes]] = deque(maxlen=max(most, 2))
        self.changed = threading.Condition()
        self.is_ended = False

    @property
    def due(self) -> float:
        """When the next picture is taken [s, monotonic]."""
        return (self.tick + 1) / self.fps

    def put(self, taken: float, picture: bytes) -> None:
        """Have a picture sent when it is time, unless a fault prevents it."""
        sensor = self.sensor
        if random.random() < sensor.drop:
            return
        if sensor.is_torn:
            picture = picture[: 2 * len(picture) // 3]
        with self.changed:
            self.waiting.append((taken + LATENCY + sensor.delay, device_time(sensor.shows, taken), picture))
            self.changed.notify()

    def next(self) -> tuple[float, bytes] | None:
        """Wait for the next picture and for the time to send it; None when the stream ends."""
        with self.changed:
            while not self.is_ended and self.plugs == self.sensor.plugs:
                wait = self.waiting[0][0] - time.monotonic() if self.waiting else 0.1
                if self.waiting and wait <= 0:
                    return self.waiting.popleft()[1:]
                self.changed.wait(min(wait, 0.1))
        return None


class Eyes:
    """Draws the streams that clients ask for."""

    def __init__(self, parts: Parts, shared: SharedState) -> None:
        """Compose the scene."""
        self.world = World(compose(parts).compile(), frequency=100)
        self.streams: list[Stream] = []
        self.parts, self._shared = parts, shared
        self.depth = {one.name for one in parts.cameras if one.camera.has_depth} if parts.setup.cameras.depth else set()
        """Names of the cameras that have depth."""
        self._cameras: dict[tuple[tuple[int, int], bool], SimCameras] = {}
        self._skins = {skin.name: SimTactile(self.world, skin) for skin in parts.tactile}
        self._forces: dict[str, np.float64] = {}
        self.sensors: dict[str, Sensor] = {}
        for camera in parts.cameras:
            modes = {(mode.width, mode.height): mode.rates for mode in camera.camera.modes}
            self.sensors[camera.name] = Sensor(camera.name, modes)
        for skin in parts.tactile:
            self.sensors[skin.name] = Sensor(skin.name, {skin.sensor.frame_size: (skin.sensor.rate,)})

    def draw(self) -> None:
        """Draw what is due, or wait a little."""
        now = time.monotonic()
        self.streams = [one for one in self.streams if not one.is_ended]
        due = [one for one in self.streams if one.due <= now]
        if not due:
            nearest = min((one.due for one in self.streams), default=now + 0.02)
            time.sleep(min(max(nearest - now, 0.0), 0.02))
            return
        values, taken = self._shared.read()
        state, forces = np.split(values, [self.world.core.state_size])
        self.world.core.set_state(state)
        self.world.refresh()
        self._forces = dict(zip(self._skins, forces, strict=True))
        drawn: dict[tuple[str, tuple[int, int], str, bool], bytes] = {}
        for stream in due:
            stream.tick = int(now * stream.fps)
            if now < stream.sensor.frozen_until:
                continue
            key = (stream.sensor.shows, stream.size, stream.format, stream.sensor.is_black)
            if key not in drawn:
                drawn[key] = self._picture(*key)
            stream.put(taken, drawn[key])

    def about(self, name: str) -> dict[str, Any]:
        """Return what a camera tells about itself: serial number, name, modes and how it sees in them."""
        camera = next(one for one in self.parts.cameras if one.name == name)
        modes: list[dict[str, Any]] = []
        for mode in camera.camera.modes:
            optics = Optics(camera, (mode.width, mode.height), self.world.model)
            fovy = self.world.model.cam_fovy[optics.id]
            seen = Intrinsics.of_matrix(optics.intrinsics(fovy), (mode.width, mode.height), optics.distortion(fovy))
            modes.append({"rates": mode.rates, **describe(seen)})
        label, has_depth = camera.camera.label, name in self.depth
        return {"serial": serial_of(name), "name": label, "has_depth": has_depth, "modes": modes}

    def _picture(self, name: str, size: tuple[int, int], format: str, is_black: bool) -> bytes:  # noqa: A002
        """Return what a sensor shows, in the format of a stream."""
        width, height = size
        rgb, depth = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.uint16)
        if not is_black and name in self._skins:
            rgb = np.ascontiguousarray(self._skins[name].read(self._forces[name])["rgb"])
        elif not is_black:
            has_depth = format == RGBD and name in self.depth
            if (size, has_depth) not in self._cameras:
                there = [one for one in self.parts.cameras if one.name in self.depth or not has_depth]
                self._cameras[size, has_depth] = SimCameras(self.world, there, size=size, has_depth=has_depth)
            frame = self._cameras[size, has_depth].read([name])[name]
            rgb, depth = np.ascontiguousarray(frame["rgb"]), frame.get("depth", depth)
        if format == JPEG:
            return simplejpeg.encode_jpeg(rgb, QUALITY, "RGB", "444")
        return rgb.tobytes() + (depth.astype("<u2").tobytes() if format == RGBD else b"")


def serve(eyes: Eyes) -> ThreadingHTTPServer:
    """Return a server of streams at a free port, which runs in threads."""
    cameras = {one.name for one in eyes.parts.cameras}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            parts = urlsplit(self.path)
            sensor = eyes.sensors.get(parts.path.strip("/"))
            if sensor is None:
                self.refuse(404, f"there is no such camera; there are {', '.join(eyes.sensors)}")
                return
            if time.monotonic() < sensor.unplugged_until:
                return
            query = parse_qs(parts.query, keep_blank_values=True)
            if "about" in query and sensor.shows in cameras:
                self.tell(eyes.about(sensor.shows))
                return
            picked = query.get("format", [JPEG])[0]
            formats = (JPEG, RGB, RGBD) if sensor.name in eyes.depth else (JPEG,)
            if picked not in formats:
                self.refuse(400, f"it has {', '.join(formats)}")
                return
            try:
                width, _, height = query["resolution"][0].partition("x")
                size, fps = (int(width), int(height)), float(query["fps"][0])
            except (KeyError, ValueError):
                size, rates = next(iter(sensor.modes.items()))
                fps = float(rates[-1])
            if fps not in sensor.modes.get(size, ()):
                each = "; ".join(f"{w}x{h} at {rates}" for (w, h), rates in sensor.modes.items())
                self.refuse(400, f"it has {each}")
                return
            self.send(Stream(sensor, size, fps, picked))

        def refuse(self, code: int, reason: str) -> None:
            self.send_response(code)
            self.send_header("X-Reason", reason)
            self.end_headers()

        def tell(self, about: Mapping[str, Any]) -> None:
            told = json.dumps(about).encode()
            self.send_response(200)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(told)))
            self.end_headers()
            self.wfile.write(told)

        def send(self, stream: Stream) -> None:
            kind = "image/jpeg" if stream.format == JPEG else "application/octet-stream"
            self.send_response(200)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
            self.send_header("X-Serial-Number", serial_of(stream.sensor.shows))
            self.end_headers()
            eyes.streams.append(stream)
            try:
                while (picture := stream.next()) is not None:
                    at, content = picture
                    head = f"Content-Type: {kind}\r\nContent-Length: {len(content)}\r\nX-Timestamp: {at:.6f}\r\n\r\n"
                    self.wfile.write(f"\r\n--{BOUNDARY}\r\n{head}".encode())
                    self.wfile.write(content)
            except OSError:  # the client is gone
                pass
            finally:
                stream.is_ended = True

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  the name that the server passes
            """Say nothing: the output is the answers'."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="camera server", daemon=True).start()
    return server


def main(read: Callable[[], str], say: Callable[[Mapping[str, Any]], None]) -> None:
    """Serve until the input ends."""
    about = json.loads(read())
    try:
        setup = Setup.from_json(about["setup"])
        eyes = Eyes(resolve(setup), SharedState(about["size"], about["file"]))
        size = eyes.world.core.state_size + len(eyes.parts.tactile)
        assert size == about["size"], "both worlds have the same scene"
    except RcsError as err:
        say({"error": str(err)})
        return
    server = serve(eyes)
    tactile = {skin.name: skin.sensor.name for skin in eyes.parts.tactile}
    cameras = {one.name: "realsense" if one.name in eyes.depth else "webcam" for one in eyes.parts.cameras}
    say({"port": server.server_port, "cameras": cameras, "tactile": tactile})
    has_ended = threading.Event()

    def listen() -> None:
        """Apply faults as they come: the loop of the world waits for the answer, and must not wait for a drawing."""
        try:
            while line := read():
                told = json.loads(line)
                eyes.sensors[told["sensor"]].tell(told["fault"], told["value"])
                say({"done": True})
        finally:
            has_ended.set()

    threading.Thread(target=listen, name="faults", daemon=True).start()
    while not has_ended.is_set():
        eyes.draw()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; the end of the input ends it
    main(sys.stdin.readline, lambda words: print(json.dumps(words), flush=True))  # noqa: T201
