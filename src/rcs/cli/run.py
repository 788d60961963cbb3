"""`rcs run`: how often a policy at an address succeeds."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rcs_data import DatasetWriter
from rcs_data.cli.console import plain_console
from rcs_data.cli.program import INTERRUPTED
from rcs_data.ledger import Ledger, write_ledger_page
from rcs_data.view import write_report
from rich.console import Console

from rcs.agents.identity import identity_of
from rcs.cli.runs import LedgerOptions, interruptible, print_results, show
from rcs.cli.setup_options import SetupOptions
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.record import recorder_of
from rcs.envs.observers.recorder import Recorder
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.policy import NOTES, Execution, ServedPolicy, fitted
from rcs.rollout.blind import evaluate_blind
from rcs.rollout.collection import Attempt
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.foreign import ForeignEnv, ForeignSimulator
from rcs.rollout.interactive.judge_page import JudgePage
from rcs.rollout.outlines import Outlines
from rcs.rollout.person import Asker, PersonJudge, ask_at_terminal
from rcs.setups.make import make
from rcs.sim.world import Stepping

if TYPE_CHECKING:
    from vlagents import Metadata

_WORDS = {True: "done", False: "not done", None: "not known"}


@dataclass(kw_only=True)
class SimulatorOptions:
    """A simulator of another project."""

    simulator: str | None = None
    """Simulator of another project, in place of the one here: `SIMULATOR:TASK`, such as `libero:libero_spatial/0`,
    `maniskill:PickCube-v1` or `metaworld:pick-place-v3`, which is started, or the address of `vlagents simulate`. The
    environment variable `VLAGENTS_TOKEN` has the token."""
    simulator_python: Path | None = None
    """Python of the simulator's environment; by default the one that `make sims` has made."""
    simulator_options: tuple[str, ...] = ()
    """Options of the simulator as NAME=VALUE, such as `size=256`."""
    mapping: Path | None = None
    """JSON file with the mapping between simulator and policy, in place of the simulator's own."""

    def foreign(self, excluded: Sequence[str]) -> ForeignSimulator | None:
        """Return the simulator; None for the one here.

        Args:
            excluded: Names of options that were given, and make no sense with it.

        Raises:
            InvalidSetup: There are such, an option is not written as one, or there is no simulator that it is for.
        """
        if self.simulator is None:
            if given := [own.name for own in fields(self) if getattr(self, own.name)]:
                raise InvalidSetup(
                    f"{', '.join(given)} is of a simulator of another project, and none is named; give simulator, too."
                )
            return None
        if excluded:
            raise InvalidSetup(
                f"{', '.join(excluded)} cannot be combined with simulator: that of another project has its own setup, "
                "of which the mapping decides what there is to decide."
            )
        if words := [word for word in self.simulator_options if "=" not in word]:
            raise InvalidSetup(f"simulator_options has {words[0]!r}; valid is NAME=VALUE, such as size=256.")
        options = dict(word.split("=", 1) for word in self.simulator_options)
        return ForeignSimulator(
            name=self.simulator, python=self.simulator_python, options=options, mapping=self.mapping
        )


@dataclass(kw_only=True)
class RunCommand(SetupOptions):
    """Run a policy that is served at an address in seeded episodes, and show how often it succeeds.

    Control, cameras and their size are those that the policy names, unless they are given. The episodes are none that
    `rcs collect` or a training ever sees. Without `--real-time`, simulated time stands still while the policy computes,
    and the same seed gives the same episodes. Ctrl-C ends after the running episode, a second one at once.

    With `--hardware`, the episodes are on real devices, which hold at the end of each, when the policy is late or lost,
    and when anything fails. No arm goes home in between: an episode begins where the one before ended. Without
    `--judge`, nobody says how they went.

    With `--simulator`, they are in another project's simulator, which says how they went. One that fails gives an
    episode without a verdict.
    """

    policy: str
    """Address of the policy: `vla://host:port`, `vlas://`, `ws://`, `wss://`, `gr00t://` or `openvla+http://`. The
    environment variable `VLAGENTS_TOKEN` has the token."""
    agent: tyro.conf.Suppress[None] = None  # pyright: ignore[reportIncompatibleVariableOverride]
    """The policy acts."""
    task: str = "PickCuboid"  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    """Name of the task, such as PickCuboid, or `module:Class`. None with `--simulator`."""
    episodes: int = 20
    """Number of episodes."""
    instruction: str | None = None
    """Instruction to the policy; the one of the task when not given."""
    execution: Annotated[Execution, tyro.conf.OmitArgPrefixes] = field(default_factory=Execution)
    timeout: float = 5.0
    """How long an answer may take by the clock [s]."""
    certificate: str | None = None
    """File with the certificate that a server's must be signed by, for `vlas://` and `wss://`."""
    described_in: Path | None = None
    """JSON file with the policy's metadata, for servers that do not send them: those of openpi, GR00T and OpenVLA."""
    hardware: str | None = None
    """Real devices: the JSON file of a site, or `driver:address` for all arms with their end effectors. All else is
    simulated, in real time. A device that fails ends the run."""
    simulation: Annotated[SimulatorOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=SimulatorOptions)
    blind: str | None = None
    """Address of another policy, to compare the two blindly: both act on each seed, in a drawn order, and nothing on
    screen says which. In files and on pages they are X and Y until `rcs unblind`."""
    judge: bool = False
    """Ask at the terminal after each episode whether the task was done. The next one begins with the answer; on devices
    the first one, and one after a fault, begins with Enter. The last answer can be taken back, except with
    `--record`."""
    page: str | None = None
    """Ask on a page in the browser instead, at `HOST:PORT`, such as `127.0.0.1:8080`, which shows the pictures of the
    cameras, and in them where the objects of the next episode go; `0.0.0.0:8080` lets other machines in, over TLS and
    with a code."""
    real_time: bool = False
    """Step by the wall clock, and ask in a thread."""
    ledger: Annotated[LedgerOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LedgerOptions)
    record: Path | None = None
    """Folder of a dataset in which every episode is recorded, with latency, age and place in the chunk of each step."""

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        console, summary = plain_console(soft_wrap=False), Summary()
        ledger, served = self.ledger.checked(), self._served(self.policy)
        metadata = served.metadata()
        real = [name for name in ("hardware", "real_time") if getattr(self, name)]
        simulator = self.simulation.foreign([*self.given, *["task"] * (self.task != RunCommand.task), *real])
        if self.blind is not None:
            return self._compare_blindly(self.blind, served, ledger, console)
        foreign = None if simulator is None else ForeignEnv(simulator)
        evaluation = Evaluation(
            setup=fitted_setup(self, metadata, "realtime" if self.real_time else None)
            if foreign is None
            else foreign.setup,
            simulator=simulator,
            agent=served,
            episodes=self.episodes,
            seed=self.seed,
            **ledger,
        )
        if self.ledger.videos and self.hardware and self.record is not None and not evaluation.setup.cameras:
            raise InvalidSetup(
                "videos of real episodes are cut from their recording, and this one has no camera. Name cameras, or "
                "leave videos out."
            )
        if not metadata.checkpoint_hash:
            console.print(
                f"{metadata.name} does not say which weights act: episodes of other weights with the same description "
                "would be taken for its own. Give each its --name.",
                soft_wrap=True,
            )
        started, videos = time.perf_counter(), 0
        try:
            text = "Ending after the running episode; press Ctrl-C again to end at once."
            with interruptible(summary, console, text):
                self._episodes(evaluation, summary, console, foreign)
            videos = self.ledger.videos
        finally:
            print_results(evaluation, summary, videos, time.perf_counter() - started, "one", console, self.record)
            if summary.attempts and self.record is not None and self.record.is_dir():
                console.print(f"Recorded: {write_report(self.record)}", soft_wrap=True)
        return INTERRUPTED if summary.is_interrupted else 0

    def _compare_blindly(self, other: str, served: ServedPolicy, ledger: dict[str, Any], console: Console) -> int:
        """Compare two policies blindly, and return the exit code."""
        if (
            wrong := ["simulator"] * (self.simulation.simulator is not None)
            + ["videos"] * bool(self.ledger.videos)
            + [name for name in ("name", "against", "until") if ledger[name] is not None]
        ):
            raise InvalidSetup(f"{', '.join(wrong)} cannot be combined with blind.")
        setup = fitted_setup(self, served.metadata(), "realtime" if self.real_time else None)
        one = Evaluation(setup=setup, agent=served, episodes=self.episodes, seed=self.seed, **ledger)
        evaluations, summary = (one, replace(one, agent=self._served(other))), Summary()
        with (
            interruptible(summary, console),
            make(setup, hardware=self.hardware) as env,
            self._recorder(env) as recorder,
            self._person(env, console) as judge,
        ):
            for attempt in evaluate_blind(evaluations, summary, env, judge=judge, recorder=recorder):
                text = _WORDS[attempt.result.success]
                console.print(f"Episode {len(summary.attempts)} of {2 * len(one.numbers)}: {text}")
            if judge is not None and not summary.is_interrupted:
                judge.end()
        with Ledger(self.ledger.out) as made:
            console.print(f"Report: {write_ledger_page(made)}", soft_wrap=True)
        console.print(f"`rcs unblind {self.ledger.out}` says who X and Y are.", soft_wrap=True)
        return INTERRUPTED if summary.is_interrupted else 0

    def _person(self, env: Env, console: Console) -> AbstractContextManager[PersonJudge | None]:
        """Return who judges; None if nobody does."""
        if not self.judge and self.page is None:
            return nullcontext()
        return person(env, console, self.page, is_real=self.hardware is not None, can_undo=self.record is None)

    @contextmanager
    def _recorder(self, env: Env, **origin: Any) -> Generator[Recorder | None]:
        """Yield what records every episode; None without a dataset."""
        if self.record is None:
            yield None
            return
        info = dataset_info(env, instruction=self.instruction, notes=NOTES)
        with DatasetWriter.open(self.record, replace(info, origin={**info.origin, **origin}), resume=True) as writer:
            recorder = recorder_of(env, writer)
            env.add_observer(recorder)
            yield recorder

    def _served(self, address: str) -> ServedPolicy:
        if "://" not in address:
            raise InvalidSetup(f"The policy is {address!r}; valid is an address, such as vla://127.0.0.1:8090.")
        return ServedPolicy(
            address=address,
            execution=self.execution,
            instruction=self.instruction,
            timeout=self.timeout,
            certificate=self.certificate,
            described_in=None if self.described_in is None else str(self.described_in),
        )

    def _episodes(self, evaluation: Evaluation, summary: Summary, console: Console, foreign: ForeignEnv | None) -> None:
        env = make(evaluation.setup, hardware=self.hardware) if foreign is None else foreign
        identity = identity_of(evaluation.agent, evaluation.setup.task)
        with (
            env,
            self._recorder(env, policy=identity.name, weights=identity.weights) as recorder,
            self._person(env, console) as judge,
        ):
            attempts = evaluate(evaluation, summary, env=env, judge=judge, recorder=recorder)
            if judge is not None:
                ask_about(attempts, len(evaluation.numbers), summary, judge, console)
                return
            title = f"{evaluation.setup.task} on {evaluation.setup.robot_label}"
            show(attempts, title, len(evaluation.numbers), console, summary)


@contextmanager
def person(
    env: Env, console: Console, page: str | None, *, is_real: bool = True, can_undo: bool = True
) -> Generator[PersonJudge]:
    """Yield a person who judges episodes, at the terminal or on a page.

    Args:
        env: The environment.
        console: Where the page's address is printed.
        page: `HOST:PORT` of the page; None for the terminal.
        is_real: Whether the person puts objects where an episode needs them.
        can_undo: Whether an answer can be taken back.
    """
    with ExitStack() as stack:
        outlines = stack.enter_context(Outlines(env.setup)) if is_real else None
        ask: Asker = ask_at_terminal
        if page is not None:
            host, port = _host_and_port(page)
            shown = stack.enter_context(JudgePage(env, outlines, host=host, port=port))
            console.print(f"Open {shown.url} in a browser to judge.", soft_wrap=True)
            ask = shown.ask
        yield PersonJudge(ask, outlines=outlines, can_undo=can_undo)


def ask_about(attempts: Iterator[Attempt], total: int, summary: Summary, judge: PersonJudge, console: Console) -> None:
    """Go through attempts that a person judges, and print each answer: a bar would write over the questions."""
    for attempt in attempts:
        text = _WORDS[attempt.result.success]
        console.print(f"Episode {attempt.number + 1} of {total}: {text}")
    if not summary.is_interrupted:
        judge.end()


def _host_and_port(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise InvalidSetup(f"page is {text!r}; valid is HOST:PORT, such as 127.0.0.1:8080.")
    return host, int(port)


def fitted_setup(options: SetupOptions, metadata: Metadata, stepping: Stepping | None = None) -> Setup:
    """Return the setup that options ask for, and the policy where they say nothing."""
    setup = options.setup(stepping, cameras="all")
    given = set(options.given)
    if given & {"control", "relative"}:
        given |= {"control", "relative"}
    if "camera_mode" in given:
        given.add("image_size")
    return fitted(setup, metadata, given)
