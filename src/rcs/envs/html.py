"""How an environment looks in a notebook: its setup, its stack and a picture, in HTML that needs nothing else."""

from __future__ import annotations

from dataclasses import fields

from rcs.envs.setup import Setup
from rcs.envs.step.simulation import Simulation
from rcs.errors import MissingDependency
from rcs.sim.viewer import Picture

SIZE = (320, 240)
"""Width and height of the picture [px]."""


def to_html(text: str, setup: Setup | None, simulation: Simulation | None) -> str:
    """Return an environment as HTML.

    Args:
        text: The printed environment; its first line is the title.
        setup: What it was made from; the table has the fields that are not at their defaults.
        simulation: What the picture is of; None for an environment without one.
    """
    from rcs_data.view.html import element, joined, table  # pages are nothing that an environment needs

    title, _, stack = text.partition("\n")
    chosen = [] if setup is None else [(one.name, getattr(setup, one.name), one.default) for one in fields(setup)]
    shown = [
        (name, value)
        for name, value, default in chosen
        if name in ("task", "robot") or (value != default and value != {})
    ]
    picture = None if simulation is None else _picture(simulation)
    return joined([element("h4", title), picture, table(shown), element("pre", stack)])


def _picture(simulation: Simulation) -> str | None:
    """Return a picture of the present state; nothing where none can be drawn."""
    from rcs_data.view.html import picture_tag

    picture = Picture(simulation.world, size=SIZE)
    try:
        return picture_tag(picture.draw(), height=SIZE[1], title="The scene")
    except MissingDependency:  # no OpenGL
        return None
    finally:
        picture.close()
