"""Options of a setup on the command line."""

from __future__ import annotations

import rcs
from rcs.cli.setup_options import changed


def test_a_mode_takes_the_place_of_a_size_and_a_size_that_of_a_mode() -> None:
    setup = rcs.Setup(cameras=rcs.Cameras(names=("wrist",), image_size=64))
    moded = changed(setup, {"camera_mode": "848x480"})
    assert (moded.cameras.mode, moded.cameras.size_of("wrist")) == ("848x480", (848, 480))
    other = changed(moded, {"camera_mode": "640x480"})
    assert (other.cameras.mode, other.cameras.size_of("wrist")) == ("640x480", (640, 480))
    sized = changed(other, {"image_size": 32})
    assert (sized.cameras.mode, sized.cameras.size_of("wrist")) == (None, (32, 32))
