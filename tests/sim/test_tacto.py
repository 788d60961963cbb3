from __future__ import annotations

import collections
import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from rcs.errors import InvalidSetup, MissingDependency
from rcs.robots.tactile import DIGIT
from rcs.sim.gel import Gel, GelLight
from rcs.sim.tacto import Tacto

GEL = Gel(DIGIT)
HAS_TACTO = importlib.util.find_spec("tacto") is not None


def pressed() -> np.ndarray:
    """A ball of 6 mm, 1.5 mm deep and off the middle."""
    _, slope_y, slope_z = GEL.ray_slopes
    centre = np.array([DIGIT.gel_center[0] - 0.0015 + 0.006, 0.003, 0.004])
    rays = np.stack([np.ones(GEL.grid), slope_y, slope_z], axis=-1)
    squared = (rays**2).sum(axis=-1)
    along = rays @ centre / squared
    inside = along**2 - (centre @ centre - 0.006**2) / squared
    return GEL.displacement(np.where(inside >= 0.0, along - np.sqrt(np.maximum(inside, 0.0)), np.inf))


@pytest.mark.skipif(HAS_TACTO, reason="Tacto is installed")
def test_without_tacto_the_error_names_the_extra() -> None:
    with pytest.raises(MissingDependency, match=r"robot-control-stack\[tacto\]"):
        Tacto(DIGIT, GEL)


def test_names_that_are_lent_for_the_import_are_gone_after_it() -> None:
    from rcs.sim.tacto import _names_of_2018

    with _names_of_2018():
        assert hasattr(collections, "Mapping") and hasattr(np, "float_")
    assert not hasattr(collections, "Mapping") and "float_" not in vars(np)


def test_another_sensor_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="not 'gelsight'"):
        Tacto(replace(DIGIT, name="gelsight"), GEL)


@pytest.mark.extras
@pytest.mark.gl
@pytest.mark.skipif(not HAS_TACTO, reason="needs the extra tacto")
def test_tacto_sees_the_patch_where_this_library_sees_it() -> None:
    tacto, ours = Tacto(DIGIT, GEL), GelLight(DIGIT, GEL)
    displacement = pressed()
    at_rest = np.zeros_like(displacement)
    try:
        tacto.draw(at_rest)
    except MissingDependency as err:
        pytest.skip(str(err))
    theirs = np.abs(tacto.draw(displacement).astype(int) - tacto.draw(at_rest)).sum(axis=2)
    mine = np.abs(ours.draw(displacement).astype(int) - ours.background).sum(axis=2)
    tacto.close()
    tacto.close()
    assert theirs.shape == mine.shape == (240, 320)
    both = [np.argwhere(change > 0.5 * change.max()) for change in (theirs, mine)]
    np.testing.assert_allclose(both[0].mean(axis=0), both[1].mean(axis=0), atol=3.0)
    np.testing.assert_allclose(np.ptp(both[0], axis=0), np.ptp(both[1], axis=0), rtol=0.1)
