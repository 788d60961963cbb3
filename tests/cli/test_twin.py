"""`rcs twin`: it shows errors and lag, and says in its exit code whether there was an alarm."""

from __future__ import annotations

import re
import urllib.request
from typing import Any

import numpy as np
import pytest
import viser

import rcs
from rcs.agents import JointSweep
from rcs.cli.main import main
from rcs.errors import InvalidSetup
from rcs.rollout.interactive.twin_view import TwinView


def test_errors_lag_and_no_alarm_are_shown_of_a_stand_in_that_follows(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["twin", "--delay", "0.04", "--seconds", "2.5"])
    told = capsys.readouterr().out
    assert ended.value.code == 0
    lag = re.search(r"fr3: lag ([\d.]+) ms", told)
    assert lag is not None
    assert float(lag[1]) == pytest.approx(40.0, abs=5.0)
    assert "joint7" in told
    assert "no alarm" in told


def test_one_that_stops_is_told_and_ends_it(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["twin", "--robot", "ur5e", "--freeze-after", "1.5", "--seconds", "8"])
    assert ended.value.code == 1
    assert "ALARM  ur5e: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--delay", "-1"], "delay is -1"), (["--robot", "fr4"], "Did you mean 'fr3'"), (["--period", "0"], "period 0")],
)
def test_errors_say_what_is_wrong(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["twin", *arguments])
    assert ended.value.code == 1
    assert words in capsys.readouterr().err


def test_the_page_shows_the_robot_and_its_twin_side_by_side() -> None:
    with rcs.make("Free", relative=False, hardware="sim") as env, rcs.attach_twin(env) as twin:
        agent = JointSweep(env)
        with TwinView(env.robots, twin, port=0) as view:
            view.show()  # nothing is known yet
            agent.reset(*env.reset())
            for _ in range(30):
                _, *_, info = env.step(agent.act({}, {}))
            assert info["twin"]["fr3"]["alarm"] == ""
            view.show()
            (robot, _), (other, _) = view._pictures
            compared: Any = twin.comparisons["fr3"]
            for world in (robot, other):
                assert abs(world.arms["fr3"].joints - compared.measured).max() < 0.05
            assert "in blue" in view._text.content
            assert view._server is not None
            nodes = view._server.scene._handle_from_node_name
            meshes = {
                name: np.array(node.color, int) for name, node in nodes.items() if isinstance(node, viser.MeshHandle)
            }
            arm = [name for name in meshes if name.startswith("/robot/fr3")]
            assert arm
            for name in arm:
                mine, its = meshes[name], meshes[name.replace("/robot/", "/twin/", 1)]
                assert its[2] - its[0] > mine[2] - mine[0] + 40, "each part of the twin is bluer"
            with urllib.request.urlopen(view.url, timeout=30) as page:
                assert page.status == 200
        view.close()


def test_a_sweep_needs_absolute_joints() -> None:
    with rcs.make("Free") as env, pytest.raises(InvalidSetup, match="relative='absolute'"):
        JointSweep(env)
