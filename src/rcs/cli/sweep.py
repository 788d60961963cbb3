"""`rcs sweep`: how often the checkpoints of a training succeed, and the best of them again."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rcs_data.cli.console import plain_console
from rcs_data.cli.program import INTERRUPTED
from rcs_data.ledger import Ledger
from rcs_data.ledger.condition import key_of
from rcs_data.read.verdicts import Verdicts
from rich.console import Console

from rcs.cli.run import ask_about, fitted_setup, person
from rcs.cli.runs import LedgerOptions, PoolOptions, attempts_of, interruptible, print_results, show
from rcs.cli.setup_options import SetupOptions, changed
from rcs.envs.env import Env
from rcs.errors import InvalidSetup, RcsError
from rcs.policy import Execution, ServedPolicy
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.serving import serving
from rcs.setups.make import make

CHECKPOINTS, DESCRIPTION, LAST, WEIGHTS = "checkpoints", "checkpoint.json", "last", "pretrained_model"
"""Names in the folders of runs: ours have a description; those of LeRobot a link to the last whole one, and weights."""
AGAIN = "again"
"""Tag of the evaluation of the best checkpoint on seeds that did not choose it."""
_KEPT = "`rcs train` keeps those that it evaluates: train with --episodes above 0"
_PAUSE = 5.0
_OTHER_SEEDS = 1 << 31
"""Added to the seed when the best is evaluated again."""


@dataclass(kw_only=True)
class SweepCommand(SetupOptions):
    """Evaluate all checkpoints of a training, and the best of them again on other seeds.

    The best of many is chosen by luck, too: only its success on seeds that did not choose it is without a bias. Every
    episode is in the ledger, so that the same command goes on after a kill, and takes in new checkpoints.
    Several sweeps of one run share the episodes, and each waits for those of the others before it goes on; with
    `--serve`, each has a GPU of its own, where there are several.
    """

    training: tyro.conf.Positional[Path]
    """Folder of the run of `rcs train`, or of LeRobot, which needs `--serve`."""
    agent: tyro.conf.Suppress[None] = None  # pyright: ignore[reportIncompatibleVariableOverride]
    """The checkpoints act."""
    task: str | None = None  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    """Name of the task; by default that of the training, and PickCuboid with `--serve`."""
    serve: str | None = None
    """Command that serves a checkpoint, with `{checkpoint}` and `{port}`, such as `envs/lerobot/bin/vlagents serve act
    --checkpoint {checkpoint} --port {port}`. It is ended, with all its children, after the checkpoint's episodes."""
    execution: Annotated[Execution, tyro.conf.OmitArgPrefixes] = field(default_factory=Execution)
    episodes: int = 100
    """Number of episodes of each checkpoint."""
    hardware: str | None = None
    """Real devices in further episodes of each checkpoint, after the simulated ones: the JSON file of a site, or
    `driver:address` for all arms with their end effectors. The person who watches says how each went, as with `rcs
    run --judge`."""
    real_episodes: int = 20
    """Number of these episodes, with the first seeds of the others."""
    page: str | None = None
    """Ask on a page in the browser instead of the terminal, at `HOST:PORT`, as `rcs run --page`."""
    follow: bool = False
    """Wait for more checkpoints until the training has made its last; of LeRobot's, until Ctrl-C."""
    pool: Annotated[PoolOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PoolOptions)
    ledger: Annotated[LedgerOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LedgerOptions)

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        options, console = self.ledger.checked(), plain_console(soft_wrap=False)
        if not (found := checkpoints_in(self.training)) and not self.follow:
            raise InvalidSetup(f"There is no checkpoint in {self.training}; valid is the folder of a run.")
        if self.page is not None and self.hardware is None:
            raise InvalidSetup("page asks how episodes on devices went; name these by hardware.")
        if self.real_episodes != SweepCommand.real_episodes and self.hardware is None:
            raise InvalidSetup("real_episodes are on devices; name these by hardware.")
        chunks = [name for name, value in asdict(self.execution).items() if value != getattr(Execution(), name)]
        if self.serve is None and chunks:
            raise InvalidSetup(
                f"{', '.join(chunks)} is for chunks of a served policy; give serve, too, or leave it out."
            )
        if self.serve is not None and (self.pool.ray is not None or self.pool.workers > 1):
            raise InvalidSetup(
                "serve has one process, beside its server: leave out workers and ray, and start more sweeps."
            )
        rates: dict[int, tuple[float, Path]] = {}
        while True:
            for steps, path in (one for one in found if one[0] not in rates):
                try:
                    summary = self._evaluate(steps, path, options, console)
                except (RcsError, OSError):
                    if path.is_dir():
                        raise
                    console.print(f"{steps} steps: the training has removed this checkpoint; it is left out.")
                    continue
                if summary.is_interrupted:
                    return INTERRUPTED
                rates[steps] = (summary.successes / summary.judged if summary.judged else -1.0, path)
            if not self.follow or (found and self._is_last(*found[-1])):
                break
            try:
                time.sleep(_PAUSE)
            except KeyboardInterrupt:  # no checkpoint is waited for any more; elsewhere it ends the sweep at once
                if not rates:
                    raise
                break
            found = checkpoints_in(self.training)
        if not rates:
            raise InvalidSetup(f"The training has removed all checkpoints in {self.training}; {_KEPT}.")
        steps = max(rates, key=lambda one: (rates[one][0], one))
        console.print(f"Best of {len(rates)}, by the episodes above: {steps} steps. Now on other seeds:")
        again = {**options, "tags": {**(self.ledger.tags or {}), "sweep": AGAIN}}
        summary = self._evaluate(steps, rates[steps][1], again, console, seed=self.seed + _OTHER_SEEDS)
        verdicts = Verdicts.of(result.success for result in summary.results)
        left_out = f"; {verdicts.not_judged} not judged" if verdicts.judged and verdicts.not_judged else ""
        console.print(f"{steps} steps, on seeds that did not choose it: {verdicts}{left_out}", soft_wrap=True)
        return INTERRUPTED if summary.is_interrupted else 0

    def _evaluate(
        self, steps: int, path: Path, options: dict[str, Any], console: Console, seed: int | None = None
    ) -> Summary:
        """Evaluate a checkpoint and print how it went."""
        name = f"{self.ledger.name or name_of(path)}@{steps}" + ("" if seed is None else f" {AGAIN}")
        summary, started = Summary(), time.perf_counter()
        with ExitStack() as stack:
            if self.serve is None:
                setup, agent, trained = self._own_setup(path), str(path), None
            else:
                self.ledger.out.mkdir(parents=True, exist_ok=True)
                out = self.ledger.out.resolve()  # `.` has no name
                log = out.with_name(f"{out.name}-server.log")
                address = stack.enter_context(serving(self.serve, path, log))
                agent = ServedPolicy(address=address, execution=self.execution, trained=steps)
                setup, trained = fitted_setup(replace(self, task=self.task or "PickCuboid"), agent.metadata()), steps
            evaluation = Evaluation(
                **options,
                setup=setup,
                agent=agent,
                episodes=self.episodes,
                seed=self.seed if seed is None else seed,
                workers=1 if trained is not None else self.pool.processes(self.episodes),
                ray=self.pool.ray,
            )
            evaluation, real = replace(evaluation, name=name), None
            if self.hardware is not None and seed is None:  # errors in it are raised before anything runs
                real = stack.enter_context(make(setup, hardware=self.hardware))
            attempts, made_by = attempts_of(evaluation, summary, self.pool)
            with interruptible(summary, console):
                show(attempts, name, len(evaluation.numbers), console, summary)
                while wait_for_others(evaluation, summary):
                    for _ in attempts_of(evaluation, summary, self.pool)[0]:
                        pass
            print_results(evaluation, summary, self.ledger.videos, time.perf_counter() - started, made_by, console)
            if real is not None and not summary.is_interrupted:
                summary.is_interrupted = self._evaluate_on(real, evaluation, console)
        return summary

    def _evaluate_on(self, real: Env, evaluation: Evaluation, console: Console) -> bool:
        """Evaluate a checkpoint on devices, print how it went, and return whether that was interrupted."""
        evaluation = replace(evaluation, episodes=self.real_episodes, workers=1, ray=None, against=None, until=None)
        summary, started = Summary(), time.perf_counter()
        with interruptible(summary, console), person(real, console, self.page) as judge:
            attempts = evaluate(evaluation, summary, env=real, judge=judge)
            ask_about(attempts, len(evaluation.numbers), summary, judge, console)
        print_results(evaluation, summary, 0, time.perf_counter() - started, "one", console)
        return summary.is_interrupted

    def _own_setup(self, path: Path) -> Any:
        """Return the environment of a checkpoint of ours, with the options that were given."""
        if not path.is_dir():
            raise InvalidSetup(f"The training has removed {path}; {_KEPT}.")
        if not (path / DESCRIPTION).exists():
            raise InvalidSetup(f"{path} is a checkpoint of LeRobot; say by --serve how it is served.")
        from rcs.rl.checkpoint import open_checkpoint

        setup = changed(open_checkpoint(path, trust=self.trust).training.evaluation_setup, self.given)
        if self.task is not None and self.task != setup.task:
            raise InvalidSetup(f"{path} was trained for {setup.task}, not for {self.task}.")
        return setup

    def _is_last(self, steps: int, path: Path) -> bool:
        """Return whether a training of ours is over with a checkpoint."""
        if not (path / DESCRIPTION).exists():
            return False
        from rcs.rl.checkpoint import open_checkpoint

        return steps >= open_checkpoint(path, trust=self.trust).training.steps


def wait_for_others(evaluation: Evaluation, summary: Summary, pause: float = _PAUSE) -> bool:
    """Wait for episodes of an evaluation that other processes run, repetitions aside.

    Args:
        evaluation: The evaluation, of which this process has nothing left to run.
        summary: Its results so far; `is_interrupted` ends the wait, and `is_decided` spares it.
        pause: Time between two looks at the ledger [s].

    Returns:
        Whether to evaluate again: what the summary lacks is in the ledger, or free, for its process has ended.
    """
    assert evaluation.out is not None, "a sweep has a ledger"
    known = {attempt.number for attempt in summary.attempts}
    numbers = [number for number in range(evaluation.episodes) if number not in known]
    left = {key_of(summary.condition, evaluation.seed_of(number)) for number in numbers}
    if not left or summary.is_interrupted or summary.is_decided:
        return False
    with Ledger(evaluation.out) as ledger:
        while not summary.is_interrupted:
            if left <= ledger.refresh().keys() or any(ledger.claim(key) for key in left - ledger.rows.keys()):
                return True
            time.sleep(pause)
    return False


def checkpoints_in(run: Path) -> list[tuple[int, Path]]:
    """Return steps and folders of the whole checkpoints of a run, oldest first."""
    for folder in (run / CHECKPOINTS, run / "run" / CHECKPOINTS):
        if folder.is_dir():
            found = sorted((int(path.name), path) for path in folder.iterdir() if path.name.isdigit())
            newest = _steps_of(folder / LAST, found)
            ours = [(steps, path) for steps, path in found if (path / DESCRIPTION).is_file()]
            theirs = [(steps, path / WEIGHTS) for steps, path in found if newest is not None and steps <= newest]
            return ours or theirs
    return []


def _steps_of(last: Path, found: Sequence[tuple[int, Path]]) -> int | None:
    """Return the steps of LeRobot's newest whole checkpoint: `last` is a link to it, or a copy of it elsewhere."""
    if not last.exists():
        return None
    name = last.resolve().name
    return int(name) if name.isdigit() else max((steps for steps, _ in found), default=None)


def name_of(checkpoint: Path) -> str:
    """Return the name of the run of a checkpoint: that of the folder above `checkpoints`, or above `run`."""
    parts = Path(os.path.normpath(checkpoint.absolute())).parts  # without `..`; where links lead does not matter
    above = [part for part in parts[: len(parts) - parts[::-1].index(CHECKPOINTS) - 1] if part != "run"]
    return above[-1]
