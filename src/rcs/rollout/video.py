"""Videos of environments and recordings, as H.264 that browsers and players show; nothing has to be installed."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from rcs_data import Dataset
from rcs_data.files.durable import disk_errors, sync_folder
from rcs_data.ledger import Ledger, Row

from rcs.envs.env import Env
from rcs.envs.observer import Observer, Transition
from rcs.errors import InvalidSetup
from rcs.rollout.collection import episode_id
from rcs.sim.viewer import Picture


class Video:
    """Writes a video file, one picture at a time."""

    def __init__(self, path: str | Path, *, rate: float) -> None:
        """Prepare a file, which the first picture begins.

        Args:
            path: Path of the file, `.mp4`; its folder is created.
            rate: Pictures per second.
        """
        self._path = Path(path)
        self._rate = Fraction(rate).limit_denominator(1000)
        self._container: Any = None
        self._stream: Any = None

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Add a picture (H, W, 3), rows from the top; an odd edge loses a pixel."""
        height, width = (edge - edge % 2 for edge in picture.shape[:2])
        if self._container is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._container = av.open(
                str(self._path.absolute()), "w"
            )  # FFmpeg takes a relative "12:30/…" for an address
            self._stream = self._container.add_stream("libx264", rate=self._rate, width=width, height=height)
            self._stream.pix_fmt = "yuv420p"
            self._stream.options = {"crf": "23", "preset": "veryfast"}
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Finish the file; without a picture there is none. Closing twice is harmless."""
        if self._container is not None:
            self._container.mux(self._stream.encode(None))
            self._container.close()
            self._container = None


@contextmanager
def new_film(path: Path) -> Generator[Path]:
    """Yield the path of a draft, which becomes the film at the end of the block; without a picture there is none.

    Args:
        path: Path of the film.
    """
    draft = path.with_name(f".{path.name}")
    draft.unlink(missing_ok=True)  # left by a kill
    yield draft
    if draft.exists():
        draft.replace(path)
        sync_folder(path.parent)


class Film(Observer):
    """Draws every reset and step of a simulated environment, from the overview camera, into video files.

    For another project's simulator, these are the images of its cameras.
    """

    def __init__(self, env: Env, *, size: tuple[int, int] = (640, 480)) -> None:
        """Look at an environment; nothing is drawn outside of `into`.

        Args:
            env: The environment; it needs no `render_mode`.
            size: Width and height [px].

        Raises:
            InvalidSetup: The environment is real devices alone.
        """
        if not env.is_simulated and env.render_mode is None:
            raise InvalidSetup("Real devices have no picture to film; record them, and `rcs data view` shows frames.")
        self._env = env
        self._picture = Picture(env.simulation.world, size=size) if env.is_simulated else None
        self._video: Video | None = None

    @contextmanager
    def into(self, path: str | Path) -> Generator[None]:
        """Film what happens in the block into a file, `.mp4`, at the speed at which it happens."""
        self._video = Video(path, rate=self._env.frequency)
        self._env.add_observer(self)
        try:
            yield
        finally:
            self._env.remove_observer(self)
            self._video.close()
            self._video = None

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Draw the start."""
        self._draw()

    def on_step(self, transition: Transition) -> None:
        """Draw what the step led to."""
        self._draw()

    def _draw(self) -> None:
        if self._video is not None:
            self._video.add(self._env.render() if self._picture is None else self._picture.draw())

    def close(self) -> None:
        """Free the renderer. Closing twice is harmless."""
        if self._picture is not None:
            self._picture.close()


def cut_films(recording: Path, ledger: Ledger, condition: str, most: int) -> list[Row]:
    """Make films of episodes from the images of the first colour camera of their recording; failures come first.

    It is for real episodes, which cannot be run again to be filmed.

    Args:
        recording: The dataset in which they were recorded.
        ledger: The ledger.
        condition: The hash of their condition.
        most: How many episodes shall have a film, with those that have one.

    Returns:
        The rows of the episodes that have got one: those that are not recorded get none.

    Raises:
        InvalidSetup: The recording has no colour camera.
        DatasetError: The disk fails.
        CorruptEpisode: The recording is damaged.
    """
    dataset = Dataset.open(recording)
    cameras = [feature.key for feature in dataset.info.features if feature.colour is not None]
    if not cameras:
        raise InvalidSetup(f"{recording} has no colour camera, so nothing to cut films from.")
    rows = sorted(ledger.of(condition), key=lambda row: (row.success is not False, row.seed))[:most]
    made: list[Row] = []
    for row in rows:
        path = ledger.film(row)
        # One that a kill has interrupted is there, too, but earlier.
        found = [one for one in dataset if f"{one.id[len(episode_id(0)) + 1 :]}-".startswith(f"{row.name}-")]
        if path.is_file() or not found:
            continue
        with (
            disk_errors("write a film", path),
            new_film(path) as draft,
            closing(Video(draft, rate=dataset.info.frequency)) as video,
        ):
            for image in found[-1].frames(cameras[0]):
                video.add(image)
        made.append(row)
    return made
