"""`rcs train --policy`: a policy that imitates a dataset, trained by LeRobot in its own environment."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rcs_data import Dataset
from rcs_data.cli.convert import ExportCommand
from rcs_data.convert.options import ExportOptions
from rcs_data.convert.recipe.contents import contents
from rcs_data.convert.recipe.recipe import LerobotPolicy, recipe
from rich.console import Console

from rcs.errors import InvalidSetup

SOURCE = "source.json"
PROGRAM = "vlagents.policies.lerobot_train"


@dataclass(frozen=True, kw_only=True)
class Imitation:
    """A training by imitation: the policy, its data, and the folders."""

    policy: LerobotPolicy
    """Policy that learns."""
    dataset: Path
    """Dataset that it learns from."""
    environment: Path
    """Folder of LeRobot's environment."""
    out: Path
    """Folder for the export, the recipe and the run."""
    state: tuple[str, ...] | None = None
    """Features that the policy receives; None for joints and grippers."""
    more: tuple[str, ...] = ()
    """LeRobot's own options, such as `--steps=20000`."""


def train_policy(imitation: Imitation, console: Console) -> int:
    """Export the dataset, write the recipe, run LeRobot, and say how the policy is served; the same again goes on.

    Raises:
        InvalidSetup: There is no such environment, or the run began with another dataset.
    """
    python = imitation.environment / "bin" / "python"
    if not os.access(python, os.X_OK):
        raise InvalidSetup(
            f"There is no {python}. LeRobot needs an environment of its own: "
            f"vlagents recipe lerobot | sh -s -- {imitation.environment}"
        )
    dataset, out = Dataset.open(imitation.dataset), imitation.out
    options = ExportOptions(state=imitation.state)
    made = recipe(imitation.policy, contents(dataset, options))
    source = {
        "policy": imitation.policy,
        "digest": dataset.digest(),
        "state": None if imitation.state is None else [*imitation.state],
    }
    _check_source(out, source)
    if not (out / "export").exists():
        ExportCommand(path=imitation.dataset, out=out / "export", format=made.export_format, more=options).run()
    made.write(out / "recipe")
    (out / SOURCE).write_text(json.dumps(source, indent=2) + "\n", encoding="utf-8")
    run = out / "run"
    words = [python, "-m", PROGRAM, out / "recipe" / "lerobot.json", out / "export", run, *imitation.more]
    code = subprocess.run(words, check=False).returncode
    if code:
        console.print(f"LeRobot ended with {code}; the same command goes on from its last checkpoint.", soft_wrap=True)
        return code
    settings = out / "recipe" / "vlagents.json"
    serve = f"{imitation.environment}/bin/vlagents serve {imitation.policy} --checkpoint {run} --settings {settings}"
    console.print(f"Serve: {serve}", soft_wrap=True)
    return 0


def _check_source(out: Path, source: Mapping[str, object]) -> None:
    if not (out / SOURCE).exists():
        return
    before = json.loads((out / SOURCE).read_text(encoding="utf-8"))
    if changed := sorted(key for key in source if before.get(key) != source[key]):
        raise InvalidSetup(
            f"{out} is a run with another {' and '.join(changed)} ('digest' is the dataset's); take another --out."
        )
