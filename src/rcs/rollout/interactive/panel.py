"""The panel of the browser view: buttons, sliders, targets to drag, frames of cameras, text."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from rcs.rollout.interactive.guide import Guide
from rcs.rollout.interactive.session import Session
from rcs.sim.browser_scene import BrowserScene
from rcs.spatial import wxyz_to_xyzw, xyzw_to_wxyz

if TYPE_CHECKING:
    import viser

FRAME_PERIOD = 0.1
"""Least time between two pictures of a camera [s]."""

TEXT_PERIOD = 0.2
"""Least time between two changes of figures and sliders [s]."""

GIZMO_SHARE = 0.2
"""Size of a target to drag in proportion to the reach of its arm."""

Submit = Callable[[Callable[[], None]], None]
"""Lets the thread of the session handle a request."""


class Panel:
    """Controls of one session on all pages of a server."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        scene: BrowserScene,
        submit: Submit,
    ) -> None:
        """Put the controls on the page.

        Args:
            server: The server of the pages.
            session: The session to control.
            scene: Its scene on the same pages.
            submit: Lets the thread of the session handle a request.
        """
        self._server, self._session, self._scene, self._submit = server, session, scene, submit
        self._message = ""
        self._next_text = self._next_frame = 0.0
        self._pictures: dict[str, tuple[Any, Any]] = {}
        setup = session.setup
        server.gui.set_panel_label(f"{setup.task} on {setup.robot_label}")
        self._status = server.gui.add_markdown("")
        self._add_episode()
        self._robots = [RobotControls(server, session, guide, submit) for guide in session.guides.values()]
        self._add_cameras()
        self._add_view()
        self.show()

    def show_message(self, message: str) -> None:
        """Show a message on all pages until the next reset."""
        self._message = message
        self._next_text = 0.0

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
        session, words = self._session, self._message or self._session.problem
        reach = ", ".join(name for name, guide in session.guides.items() if guide.is_out_of_reach)
        lines = [f"**{session.env.instruction}**" if session.env.instruction else ""]
        lines.append(
            f"**{session.verdict}** · seed {session.seed} · {session.world.time:.1f} s · step {session.steps}  \n"
            f"reward {session.reward:.3f} · sum {session.total:.2f}"
        )
        if words:
            lines.append(f"> {words}")
        elif reach and session.agent is None:
            lines.append(f"> The target of {reach} is out of reach.")
        elif session.is_over:
            lines.append("> The episode is over. *Reset* repeats it, *Next seed* begins another one.")
        text = "\n\n".join(line for line in lines if line)
        if text != self._status.content:
            self._status.content = text
        self._recover.visible = bool(session.problem)

    # --- Made once ----------------------------------------------------------------------------------------------------

    def _add_episode(self) -> None:
        gui, session = self._server.gui, self._session
        with gui.add_folder("Episode"):
            times = {"Play": self._play, "Pause": self._pause, "Step": self._step}
            _buttons(gui, "Time", self._submit, times, hint="A step is one control period; it pauses.")
            self._recover = _button(gui, "Recover", self._submit, self._go_on, hint="Clear faults and go on")
            self._recover.visible = False
            self._seed = gui.add_number("Seed", session.seed, min=0, step=1, hint="Of the next reset")
            starts = {"Reset": self._reset, "Next seed": self._next}
            _buttons(gui, "Begin", self._submit, starts, hint="An episode depends on its seed alone.")
            if session.has_agent:
                agent = gui.add_checkbox("Agent acts", initial_value=session.agent is not None, hint="In a new episode")
                _on_value(agent, self._submit, self._let_agent)

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
            contacts = gui.add_checkbox("Contact forces", initial_value=False, hint="1 cm per newton")
        _on_value(targets, self._submit, self._show_targets)
        _on_value(contacts, self._submit, lambda is_on: setattr(self._scene, "has_contacts", is_on))

    # --- Requests of pages, handled by the thread of the session ------------------------------------------------------

    def _play(self) -> None:
        self._session.is_playing = True

    def _pause(self) -> None:
        self._session.is_playing = False

    def _step(self) -> None:
        self._session.is_playing = False
        self._session.step()

    def _reset(self) -> None:
        self._begin(lambda: self._session.reset(int(self._seed.value)))

    def _next(self) -> None:
        self._begin(self._session.reset)

    def _go_on(self) -> None:
        self._begin(self._session.recover)

    def _let_agent(self, is_acting: bool) -> None:
        self._begin(lambda: self._session.let_agent(is_acting))

    def _begin(self, start: Callable[[], None]) -> None:
        self._message = ""
        start()
        self._seed.value = self._session.seed
        self._scene.rebuild()
        self._next_text = 0.0
        for robot in self._robots:
            robot.snap()

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
            submit(lambda: guide.lead_to(pose))

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
        if not is_led:
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


def _place(pose: Any) -> dict[str, Any]:
    return {"position": np.array(pose[:3]), "wxyz": xyzw_to_wxyz(pose[3:])}


def _button(gui: viser.GuiApi, label: str, submit: Submit, do: Callable[[], None], hint: str | None = None) -> Any:
    button = gui.add_button(label, hint=hint)

    # Asynchronous, for these are called in the order of the clicks.
    @button.on_click
    async def _(event: Any) -> None:
        submit(do)

    return button


def _buttons(gui: viser.GuiApi, label: str, submit: Submit, choices: dict[str, Callable[[], None]], hint: str) -> None:
    group = gui.add_button_group(label, tuple(choices), hint=hint)

    @group.on_click
    async def _(event: Any) -> None:
        submit(choices[event.target.value])


def _on_value(handle: Any, submit: Submit, do: Callable[[Any], None]) -> None:
    """Let the thread of the session handle a value that a page gives a control."""

    @handle.on_update
    async def _(event: Any) -> None:
        if event.client_id is not None:  # otherwise the value is our own
            value = event.target.value
            submit(lambda: do(value))
