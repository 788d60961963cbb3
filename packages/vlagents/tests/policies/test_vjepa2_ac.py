from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest
from vlagents import InvalidInput, PartSpec
from vlagents.errors import MissingStack
from vlagents.policies.settings import Settings
from vlagents.policies.vjepa2_ac import LARGEST_GRIP, SEARCH, Vjepa2AcPolicy, plan, search_of


@pytest.fixture
def torch() -> Any:
    return importlib.import_module("torch")


def planned(torch: Any, goal: list[float], seed: int = 0, **changed: Any) -> Any:
    """Plan in a world where motions add up, towards a place and a grip."""
    end = torch.tensor(goal)

    def imagine(motions: Any) -> Any:
        return (motions.sum(dim=1) - end).norm(dim=1)

    search = {**SEARCH, "best": 20, "rounds": 12, **changed}
    return plan(torch, imagine, search, torch.Generator().manual_seed(seed), "cpu")


@pytest.mark.extras
def test_a_goal_within_reach_is_met(torch: Any) -> None:
    motion = planned(torch, [0.03, -0.04, 0.02, 0.9])
    assert torch.allclose(motion.sum(dim=0), torch.tensor([0.03, -0.04, 0.02, 0.9]), atol=0.01)


@pytest.mark.extras
def test_a_goal_beyond_reach_is_gone_towards_no_faster_than_allowed(torch: Any) -> None:
    motion = planned(torch, [1.0, 0.0, -1.0, 5.0], reach=0.05)
    assert motion[:, :3].abs().max() <= 0.05 + 1e-6
    assert motion[:, 3].abs().max() <= LARGEST_GRIP + 1e-6
    assert torch.allclose(motion[:, [0, 2]], torch.tensor([[0.05, -0.05]] * 2), atol=0.01)


@pytest.mark.extras
def test_a_grip_that_is_noise_is_left_out(torch: Any) -> None:
    motion = planned(torch, [0.02, 0.0, 0.0, 0.1], horizon=1)
    assert motion[0, 3] == 0.0


@pytest.mark.extras
def test_a_seed_gives_the_same_plan_again(torch: Any) -> None:
    first, again, other = (planned(torch, [0.03, 0.0, 0.0, 0.0], seed) for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize(
    "changed", [{"samples": 0}, {"best": 1}, {"best": 500}, {"reach": 0.0}, {"reach": 20.0}, {"rounds": 2.5}]
)
def test_a_search_that_cannot_be_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput, match=r"options of the search|The option 'rounds'"):
        search_of(Settings(options=changed))


def test_a_folder_without_both_parts_and_settings_of_the_state_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    (tmp_path / "encoder").mkdir()
    for part in ("encoder/config.json", "predictor.pt"):
        with pytest.raises(InvalidInput, match="valid is a folder with encoder/"):
            Vjepa2AcPolicy(str(tmp_path))
        (tmp_path / part).write_text("{}")
    with pytest.raises(MissingStack, match="vlagents recipe vjepa2_ac"):
        Vjepa2AcPolicy(str(tmp_path))
    for wrong in (Settings(dataset="pick"), Settings(action=(PartSpec("joints", 7),))):
        with pytest.raises(InvalidInput, match="those of DROID"):
            Vjepa2AcPolicy(str(tmp_path), wrong)
