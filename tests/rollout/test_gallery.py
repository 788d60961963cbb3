"""The gallery has a picture of every environment in both qualities, and a page that shows them all."""

from __future__ import annotations

from pathlib import Path

import pytest
import simplejpeg

from rcs.cli.main import main
from rcs.errors import DatasetError
from rcs.rollout import gallery as module
from rcs.rollout.gallery import gallery


@pytest.mark.gl
def test_one_command_draws_every_environment_in_both_qualities(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SIZE", (96, 72))
    monkeypatch.setattr(module, "STEPS", 3)
    monkeypatch.setattr(
        module, "ids", lambda: {"rcs/PickCuboid-FR3-v0": ("PickCuboid", "fr3"), "rcs/FR3-v0": ("Free", "fr3")}
    )
    with pytest.raises(SystemExit) as stopped:
        main(["gallery", "--out", str(tmp_path / "gallery")])
    assert stopped.value.code == 0
    files = {file.name for file in (tmp_path / "gallery").iterdir()}
    stem = "PickCuboid-FR3"
    pictures = {
        f"{stem}-fast.jpg",
        f"{stem}-full.jpg",
        *(f"{stem}-camera-{name}-{quality}.jpg" for name in ("wrist", "side") for quality in ("fast", "full")),
    }
    assert files == {*pictures, "index.html"}
    page = (tmp_path / "gallery" / "index.html").read_text()
    assert all(name in page for name in pictures)
    fast = simplejpeg.decode_jpeg((tmp_path / "gallery" / f"{stem}-fast.jpg").read_bytes())
    assert fast.shape == (72, 96, 3)
    assert fast.std() > 10, "there is something to see"


def test_a_folder_that_cannot_be_made_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(DatasetError, match="cannot be written"):
        list(gallery(tmp_path / "file"))
