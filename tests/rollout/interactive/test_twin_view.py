"""The page with a robot and its twin."""

from __future__ import annotations

import urllib.request
from types import SimpleNamespace
from typing import Any

import numpy as np
import viser

import rcs
from rcs.rollout.interactive.twin_view import TwinView, _words
from tests.joint_sweep import JointSweep


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


def test_names_and_alarms_are_shown_and_not_rendered() -> None:
    shown = _words("<b>left", SimpleNamespace(lag=None, rms=np.zeros(1), alarm="<img src=x onerror=alert(1)>"))
    assert "<" not in shown
    assert shown.startswith("**&lt;b&gt;left**: lag not known yet")
