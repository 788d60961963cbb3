"""Films of real episodes in a ledger, cut from their recording: they cannot be run again."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from rcs_data import Dataset
from rcs_data.files.durable import disk_errors
from rcs_data.ledger import Ledger, Row

from rcs.errors import InvalidSetup
from rcs.rollout.collection import episode_id
from rcs.rollout.video import Video, new_film


def cut_films(recording: Path, ledger: Ledger, condition: str, most: int) -> list[Row]:
    """Make films of episodes from the images of the first colour camera of their recording; failures come first.

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
