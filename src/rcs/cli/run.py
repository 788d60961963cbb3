"""`rcs run`: how often a policy at an address succeeds."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rcs_data import DatasetWriter
from rcs_data.cli.console import plain_console
from rcs_data.cli.program import INTERRUPTED
from rcs_data.view import write_report
from rich.console import Console

from rcs.cli.runs import evaluation_folder, interruptible, results_table, show
from rcs.cli.setup_options import SetupOptions
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.policy import NOTES, Execution, Mode, ServedPolicy, fitted
from rcs.rollout.episode import ask
from rcs.rollout.evaluate import UNSEEN, Evaluation, Summary, evaluate
from rcs.rollout.policy_report import write_policy_report
from rcs.setups.make import make

if TYPE_CHECKING:
    from vlagents import Metadata


@dataclass(kw_only=True)
class RunCommand(SetupOptions):
    """Run a policy that is served at an address in seeded episodes, and show how often it succeeds.

    Control, cameras and their size are those that the policy names, unless they are given. The episodes are none that
    `rcs collect` or a training ever sees. Without `--real-time`, simulated time stands still while the policy computes,
    and the same seed gives the same episodes. Ctrl-C ends after the episode at work, a second one at once.

    With `--hardware`, the episodes are on real devices, which hold at the end of each, when the policy is late or lost,
    and when anything fails. Without `--judge`, nobody says how they went.
    """

    policy: str
    """Address of the policy: `vla://host:port`, `vlas://`, `unix://`, `ws://` or `wss://`. The environment variable
    `VLAGENTS_TOKEN` has the token."""
    task: str = "PickCuboid"  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    """Name of the task, such as PickCuboid, or `module:Class`."""
    episodes: int = 20
    """Number of episodes."""
    instruction: str | None = None
    """What the policy is told to do; what the task says when not given."""
    execution: Mode = "receding"
    """How chunks are executed: `open_loop` executes rows, then holds until the next answer; `receding` asks while the
    rest is executed; `ensemble` takes the mean of all chunks; `rtc` blends over from the chunk in flight."""
    rows: int | None = None
    """Rows of a chunk that pass before the next one is asked for; all in `open_loop`, half of them otherwise."""
    latency: float = 0.0
    """How much later than asked an answer becomes known, in simulated time [s]."""
    valid_for: float | None = None
    """How old the observation may be that an action answers [s]; later, the robot holds."""
    decay: float = 0.01
    """ACT's m in `ensemble`: the weight of the i-th oldest chunk is exp(-m·i)."""
    on_loss: Literal["reconnect", "end"] = "reconnect"
    """What to do after the policy is lost, besides holding."""
    timeout: float = 5.0
    """How long an answer may take by the clock [s]."""
    certificate: str | None = None
    """File with the certificate that a server's must be signed by, for `vlas://` and `wss://`."""
    described_in: Path | None = None
    """JSON file with the policy's metadata, for `ws://` servers that do not tell them, such as openpi's."""
    hardware: str | None = None
    """What is real: the JSON file of a site, or `driver:address` for all arms with their end effectors. All else is
    simulated, in real time. A device that fails ends the run."""
    judge: bool = False
    """Ask at the terminal after each episode whether the task was done. The next one begins with the answer."""
    real_time: bool = False
    """Step by the wall clock, and ask in a thread."""
    record: Path | None = None
    """Folder of a dataset in which every episode is recorded, with latency, age and place in the chunk of each step."""
    videos: int = 0
    """Write videos of this many of the first episodes."""
    out: Path | None = None
    """New folder for the figures, the page and the videos; by default `evaluation`, or `evaluation-2` and so on."""

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        console, summary = plain_console(soft_wrap=False), Summary()
        out = evaluation_folder(self.out)
        served = self._served()
        metadata = served.metadata()
        evaluation = Evaluation(
            setup=self._setup(metadata),
            agent=served,
            episodes=self.episodes,
            seed=self.seed,
            first_seed=UNSEEN,
            videos=self.videos,
            out=out,
        )
        console.print(f"Policy: {metadata.name} at {self.policy}", soft_wrap=True)
        started = time.perf_counter()
        try:
            with interruptible(summary, console, "Ending after the episode at work; Ctrl-C again ends at once."):
                self._episodes(evaluation, summary, console)
        finally:
            if summary.attempts:
                self._tell(evaluation, summary, metadata, time.perf_counter() - started, console)
        return INTERRUPTED if summary.is_interrupted else 0

    def _served(self) -> ServedPolicy:
        if "://" not in self.policy:
            raise InvalidSetup(f"The policy is {self.policy!r}; valid is an address, such as vla://127.0.0.1:8090.")
        execution = Execution(
            mode=self.execution,
            rows=self.rows,
            latency=self.latency,
            valid_for=self.valid_for,
            decay=self.decay,
            on_loss=self.on_loss,
        )
        return ServedPolicy(
            address=self.policy,
            execution=execution,
            instruction=self.instruction,
            timeout=self.timeout,
            certificate=self.certificate,
            described_in=None if self.described_in is None else str(self.described_in),
        )

    def _setup(self, metadata: Metadata) -> Setup:
        """Return the setup that the options ask for, and the policy where they say nothing."""
        setup = self.setup("realtime" if self.real_time else None, cameras="all")
        given = set(self.given)
        if given & {"control", "relative"}:
            given |= {"control", "relative"}
        if "camera_mode" in given:
            given.add("image_size")
        return fitted(setup, metadata, given)

    def _episodes(self, evaluation: Evaluation, summary: Summary, console: Console) -> None:
        env = make(evaluation.setup, hardware=self.hardware)
        with env, ExitStack() as stack:
            recorder = None
            if self.record is not None:
                info = dataset_info(env, instruction=self.instruction, notes=NOTES)
                origin: dict[str, Any] = {**info.origin, "policy": evaluation.agent_name}
                recorder = Recorder(stack.enter_context(DatasetWriter.open(self.record, replace(info, origin=origin))))
                env.add_observer(recorder)
            judge = ask if self.judge else None
            attempts = evaluate(evaluation, summary, env=env, judge=judge, recorder=recorder)
            if self.judge:  # a bar would write over the question
                for attempt in attempts:
                    told = {True: "done", False: "not done", None: "not known"}[attempt.result.success]
                    console.print(f"Episode {attempt.number + 1} of {self.episodes}: {told}")
                return
            title = f"{evaluation.setup.task} on {evaluation.setup.robot_label}"
            show(attempts, title, self.episodes, console, summary, lambda: len(summary.attempts))

    def _tell(
        self, evaluation: Evaluation, summary: Summary, metadata: Metadata, seconds: float, console: Console
    ) -> None:
        console.print(results_table(summary, seconds, "one"))
        figures = write_policy_report(evaluation, summary, metadata)
        console.print(f"Figures: {figures.with_name('evaluation.json')}", soft_wrap=True)
        console.print(f"Report: {figures}", soft_wrap=True)
        if self.record is not None and self.record.is_dir():
            console.print(f"Recorded: {write_report(self.record)}", soft_wrap=True)
