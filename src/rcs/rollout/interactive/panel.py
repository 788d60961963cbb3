"""The panel of the browser view: buttons, sliders, targets to drag, frames of cameras, text."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from rcs.agents import Event
from rcs.agents.guide import Guide
from rcs.rollout.interactive.page import as_line
from rcs.rollout.interactive.session import Session
from rcs.spatial import wxyz_to_xyzw, xyzw_to_wxyz
from rcs.teleop import Keyboard
from rcs.teleop.takeover import people_of

if TYPE_CHECKING:
    import viser

FRAME_PERIOD = 0.1
"""Least time between two pictures of a camera [s]."""

TEXT_PERIOD = 0.2
"""Least time between two changes of figures and sliders [s]."""

GIZMO_SHARE = 0.2
"""Size of a target to drag in proportion to the reach of its arm."""

SHOWN = 8
"""Takes in the list."""

KEYS: Mapping[Event, tuple[str, Literal["T", "Y", "N", "X"]]] = {
    "start": ("Start", "T"), "success": ("Success", "Y"), "failure": ("Failure", "N"), "discard": ("Discard", "X"),
}  # fmt: skip
"""Buttons of takes, and keys that do the same."""

NOBODY = "no robot"
"""Choice of keys that lead nothing."""

KEYS_HELP = "w s, a d, r f move; o u, i k, j l turn; space: gripper; - =: slower, faster"
"""Keys that lead."""

Submit = Callable[[Callable[[], None], int | None], None]
"""Lets the thread of the session handle a request of a page that leads; None for one of any page."""


class Panel:
    """Controls of one session on all pages of a server."""

    def __init__(self, server: viser.ViserServer, session: Session, submit: Submit, keys: Keyboard) -> None:
        """Put the controls on the page.

        Args:
            server: The server of the pages.
            session: The session to control.
            submit: Lets the thread of the session handle a request.
            keys: The keys of the page that leads.
        """
        self._server, self._session, self._submit, self._keys = server, session, submit, keys
        self._message, self._robot = "", NOBODY
        self._acts: Any = None
        self._next_text = self._next_frame = 0.0
        self._pictures: dict[str, tuple[Any, Any]] = {}
        setup = session.setup
        server.gui.set_panel_label(f"{setup.task} on {setup.robot_label}")
        self._status = server.gui.add_markdown("")
        self._add_episode()
        self._takes: Any = None
        if session.can_record:
            self._add_takes()
        self._robots = [RobotControls(server, session, guide, submit) for guide in session.guides.values()]
        self._add_keys()
        self._add_cameras()
        self._add_view()
        self.show()

    def show_message(self, message: str) -> None:
        """Show a message on all pages until the next reset."""
        self._message = message
        self._next_text = 0.0

    def refuse(self, message: str) -> None:
        """Show why a page's request is refused, and put back what it has changed."""
        self.show_message(message)
        self._seed.value = self._session.seed
        self._show_who_acts()
        for robot in self._robots:
            robot.snap()

    def show(self) -> None:
        """Show what has changed, no faster than people see."""
        now = time.monotonic()
        if now >= self._next_text:
            self._next_text = now + TEXT_PERIOD
            self._show_text()
            for robot in self._robots:
                robot.show()
        if now >= self._next_frame and self._server.get_clients():
            self._next_frame = now + FRAME_PERIOD
            for name, frame in self._session.frames.items():
                handle, last = self._pictures[name]
                if frame is not last:
                    handle.image, self._pictures[name] = frame, (handle, frame)

    def _show_text(self) -> None:
        session = self._session
        failed = None if session.agent is None else session.agent.failure_message
        refused = session.info.get("refused")
        words = self._message or session.problem or (refused and f"Refused: {refused}") or failed
        reach = ", ".join(name for name, guide in session.guides.items() if guide.is_out_of_reach)
        lines = [f"**{as_line(session.env.instruction)}**" if session.env.instruction else ""]
        lines.append(
            f"**{session.verdict}** · seed {session.seed} · {session.time:.1f} s · step {session.steps}  \n"
            f"reward {session.reward:.3f} · sum {session.total:.2f}"
        )
        if session.env.is_real:
            lines.append(f"loop: {as_line(session.statistics)}")
        for person in people_of(session.agent):
            states = ", ".join([*person.states.values(), *([person.problem] if person.problem else [])])
            is_page = person is session.operator
            name = f"keys ({self._keys.speed:.2f} m/s)" if is_page else as_line(type(person.device).__name__)
            lines.append(f"{name}: {as_line(states)}" + (f"  \n{KEYS_HELP}" if is_page else ""))
        if words:
            lines.append(f"> {as_line(words)}")
        elif reach and session.agent is None:
            lines.append(f"> The target of {as_line(reach)} is out of reach.")
        elif session.is_over:
            lines.append("> The episode is over. *Reset* repeats it, *Next seed* begins another one.")
        text = "\n\n".join(line for line in lines if line)
        if text != self._status.content:
            self._status.content = text
        self._recover.visible = bool(session.problem)
        self._show_who_acts()
        if self._takes is not None and self._takes.content != (takes := self._words_on_takes()):
            self._takes.content = takes

    def _show_who_acts(self) -> None:
        by_keys = self._session.operator is not None
        _put(self._led, self._robot if by_keys else NOBODY)
        if self._acts is not None:
            _put(self._acts, self._session.agent is not None and not by_keys)

    def _words_on_takes(self) -> str:
        """Return the takes, the newest first."""
        takes = self._session.takes
        if takes is None:
            return "No take yet."
        dropped = f", {takes.dropped} images or rows dropped" if takes.dropped else ""
        now = [] if takes.now is None else [f"**{as_line(takes.now)}: recording{dropped}**"]
        return "  \n".join([*now, *(as_line(take) for take in takes.ended[: -SHOWN - 1 : -1])])

    # --- Made once ----------------------------------------------------------------------------------------------------

    def _add_episode(self) -> None:
        gui, session = self._server.gui, self._session
        with gui.add_folder("Episode"):
            times = {"Play": lambda: self._play(True), "Pause": lambda: self._play(False), "Step": self._step}
            _buttons(gui, "Time", self._submit, times, hint="A step is one control period; it pauses.")
            self._recover = _button(
                gui, "Recover", self._submit, lambda: self._begin(session.recover), hint="Clear faults and go on"
            )
            self._recover.visible = False
            self._seed = gui.add_number("Seed", session.seed, min=0, step=1, hint="Seed of the next reset")
            starts = {
                "Reset": lambda: self._begin(lambda: session.reset(int(self._seed.value))),
                "Next seed": lambda: self._begin(session.reset),
            }
            _buttons(gui, "Begin", self._submit, starts, hint="An episode depends on its seed alone.")
            if session.has_agent:
                self._acts = gui.add_checkbox("Agent acts", initial_value=False, hint="In a new episode")
                _on_value(self._acts, self._submit, lambda acts: self._begin(lambda: session.let_agent(acts)))

    def _add_takes(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Takes"):
            does = {label: partial(self._obey, event) for event, (label, _) in KEYS.items()}
            keys = ", ".join(f"{key} {label.lower()}" for label, key in KEYS.values())
            _buttons(gui, "Take", self._submit, does, hint=f"Start also ends a take, as the task judges. Keys: {keys}.")
            self._takes = gui.add_markdown("")
        for event, (label, key) in KEYS.items():
            command = gui.add_command(f"{label} take", hotkey=key)

            @command.on_trigger
            async def _(trigger: Any, event: Event = event) -> None:
                self._submit(partial(self._obey, event), trigger.client_id)

    def _add_keys(self) -> None:
        names = tuple(self._session.guides)
        self._led = self._server.gui.add_dropdown("Keys lead", (NOBODY, *names), initial_value=NOBODY, hint=KEYS_HELP)
        _on_value(self._led, self._submit, self._lead_by_keys)

    def _add_cameras(self) -> None:
        frames = self._session.frames
        if frames:
            with self._server.gui.add_folder("Cameras"):
                for name, frame in frames.items():
                    handle = self._server.gui.add_image(frame, label=name, format="jpeg", jpeg_quality=85)
                    self._pictures[name] = handle, frame

    def _add_view(self) -> None:
        gui = self._server.gui
        with gui.add_folder("View", expand_by_default=False):
            targets = gui.add_checkbox("Targets to drag", initial_value=True)
        _on_value(targets, self._of_any, self._show_targets)

    # --- Requests of pages, handled by the thread of the session ------------------------------------------------------

    def _of_any(self, request: Callable[[], None], page: int | None) -> None:
        """Submit a request that any page may make."""
        self._submit(request, None)

    def _play(self, is_playing: bool) -> None:
        self._session.is_playing = is_playing

    def _step(self) -> None:
        self._session.is_playing = False
        self._session.step()

    def _begin(self, start: Callable[[], None]) -> None:
        self._message = ""
        start()

    def _lead_by_keys(self, robot: str) -> None:
        self._message, self._robot = "", robot
        self._session.let_keys(None if robot == NOBODY else self._keys, robot)

    def begin(self) -> None:
        """Show the beginning of an episode."""
        self._message = ""
        self._seed.value = self._session.seed
        self._next_text = 0.0
        for robot in self._robots:
            robot.snap()

    def _obey(self, event: Event) -> None:
        self._message = ""
        self._session.obey(event)

    def _show_targets(self, is_on: bool) -> None:
        for robot in self._robots:
            robot.is_shown = is_on


class RobotControls:
    """A target to drag and sliders for one robot."""

    def __init__(self, server: viser.ViserServer, session: Session, guide: Guide, submit: Submit) -> None:
        """Put them on the page.

        Args:
            server: The server of the pages.
            session: The session to control.
            guide: The guide of the robot.
            submit: Lets the thread of the session handle a request.
        """
        self._session, self._guide, self._submit = session, guide, submit
        self.is_shown = True
        """Whether the target to drag is wanted."""
        name, arm = guide.robot.name, guide.robot.arm
        scale = GIZMO_SHARE * arm.workspace_reach
        self._gizmo = server.scene.add_transform_controls(
            f"/targets/{name}", scale=scale, line_width=3.0, depth_test=False, **_place(guide.goal_in_scene)
        )

        @self._gizmo.on_update
        async def _(event: Any) -> None:
            pose = np.concatenate([event.target.position, wxyz_to_xyzw(event.target.wxyz)])
            submit(lambda: guide.lead_to(pose), event.client_id)

        gui = server.gui
        self._opening: Any = None
        with gui.add_folder(f"{name}: {arm.label}"):
            if guide.has_opening:
                self._opening = gui.add_slider("Opening", 0.0, 1.0, 0.01, guide.opening)
                _on_value(self._opening, submit, self._open)
            _button(gui, "Target to the arm", submit, self._stay, hint="Stay where the arm is now")
            with gui.add_folder("Joints [rad]", expand_by_default=False):
                rows = zip(arm.joints, guide.lower, guide.upper, guide.joints, strict=True)
                self._joints = [
                    gui.add_slider(label, float(lower), float(upper), 0.001, float(np.clip(value, lower, upper)))
                    for label, lower, upper, value in rows
                ]
            for index, slider in enumerate(self._joints):
                _on_value(slider, submit, lambda value, index=index: self._turn_joint(index, value))

    def show(self) -> None:
        """Have sliders and target follow what is wanted."""
        guide = self._guide
        is_led = self._session.agent is None
        self._gizmo.visible = self.is_shown and is_led
        if not is_led or guide.is_braking:
            self.snap()
        elif not guide.is_by_joints:  # otherwise a person holds a slider
            self._follow_joints()

    def snap(self) -> None:
        """Put target and sliders where the robot is, or is wanted."""
        guide = self._guide
        pose = guide.goal_in_scene if self._session.agent is None else guide.tcp_in_scene
        for key, value in _place(pose).items():
            setattr(self._gizmo, key, value)
        self._follow_joints()
        if self._opening is not None and abs(self._opening.value - guide.opening) > 0.005:
            self._opening.value = round(guide.opening, 2)

    def _follow_joints(self) -> None:
        for slider, value in zip(self._joints, self._guide.joints, strict=True):
            if abs(slider.value - value) > 0.002:
                slider.value = float(value)

    def _open(self, opening: float) -> None:
        self._guide.opening = opening

    def _stay(self) -> None:
        self._guide.stay()
        self.snap()

    def _turn_joint(self, index: int, value: float) -> None:
        joints = self._guide.joints.copy()
        joints[index] = value
        self._guide.lead_joints_to(joints)
        for key, part in _place(self._guide.goal_in_scene).items():
            setattr(self._gizmo, key, part)


def _put(control: Any, value: Any) -> None:
    """Have a control show a value, if it shows another one."""
    if control.value != value:
        control.value = value


def _place(pose: Any) -> dict[str, Any]:
    return {"position": np.array(pose[:3]), "wxyz": xyzw_to_wxyz(pose[3:])}


def _button(gui: viser.GuiApi, label: str, submit: Submit, do: Callable[[], None], hint: str | None = None) -> Any:
    button = gui.add_button(label, hint=hint)

    # Asynchronous, for these are called in the order of the clicks.
    @button.on_click
    async def _(event: Any) -> None:
        submit(do, event.client_id)

    return button


def _buttons(gui: viser.GuiApi, label: str, submit: Submit, choices: dict[str, Callable[[], None]], hint: str) -> None:
    group = gui.add_button_group(label, tuple(choices), hint=hint)

    @group.on_click
    async def _(event: Any) -> None:
        submit(choices[event.target.value], event.client_id)


def _on_value(handle: Any, submit: Submit, do: Callable[[Any], None]) -> None:
    """Let the thread of the session handle a value that a page gives a control."""

    @handle.on_update
    async def _(event: Any) -> None:
        if event.client_id is not None:  # otherwise the value is our own
            value = event.target.value
            submit(lambda: do(value), event.client_id)
