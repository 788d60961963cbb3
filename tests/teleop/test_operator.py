"""Laws of a hand that leads a robot, in all control modes, with one arm and two."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import Agent, Guide, PerRobot
from rcs.errors import InvalidSetup, UnknownName
from rcs.spatial import distance
from rcs.teleop import Button, HandReading, LeadOptions, Operator, Takeover
from rcs.teleop.feed import News
from tests.teleop.scripted_device import LEVEL, Led, ScriptedDevice, at, held

MODES = [
    *((control, how) for control in ("joints", "tquat", "xyzrpy") for how in ("last_step", "origin", "absolute")),
    ("twist", "last_step"),
]
ARMS: list[dict[str, Any]] = [{"robot": "fr3"}, {"robot": "dual_fr3", "hands": ("left", "right")}]
Lead = Callable[..., Led]


def both(led_by: Callable[[float], HandReading], hands: tuple[str, ...]) -> Callable[[float], Any]:
    return lambda t: {name: led_by(t) for name in hands}


def spread(places: np.ndarray, of: np.ndarray) -> float:
    return float(np.linalg.norm(places[:, :3] - of[:3], axis=1).max())


def after(start: float, pose: Callable[[float], np.ndarray]) -> Callable[[float], HandReading]:
    """A hand that presses the clutch at a moment and moves from then on."""
    return lambda t: held(pose(max(t - start, 0.0)), *(("clutch",) if t >= start else ()))


@pytest.mark.parametrize("arms", ARMS, ids=["one", "two"])
@pytest.mark.parametrize(("control", "relative"), MODES)
def test_engaging_with_a_still_hand_moves_nothing(
    lead: Lead, control: Any, relative: Any, arms: dict[str, Any]
) -> None:
    hands = arms.get("hands", ("right",))
    led = lead(both(after(0.5, lambda t: at(0.3, 0.1, 1.0)), hands), control=control, relative=relative, **arms)
    led.run(0.5)
    before = led.tcp
    places = led.run(1.0)
    assert set(led.operator.states.values()) == {"engaged"}
    assert spread(places, before) < 1e-4


@pytest.mark.parametrize("arms", ARMS, ids=["one", "two"])
@pytest.mark.parametrize(("control", "relative"), MODES)
def test_a_circle_of_the_hand_at_half_scale_is_half_the_circle(
    lead: Lead, control: Any, relative: Any, arms: dict[str, Any]
) -> None:
    def circle(t: float) -> np.ndarray:
        turn = 2 * np.pi * np.clip(t - 0.5, 0.0, 8.0) / 4.0
        return at(0.1 * (1 - np.cos(turn)), 0.1 * np.sin(turn), 1.0)

    hands = arms.get("hands", ("right",))
    options = LeadOptions(scale=0.5)
    led = lead(both(after(0.3, circle), hands), control=control, relative=relative, options=options, **arms)
    led.run(0.3)
    start = led.tcp
    places = led.run(4.5)[-round(30 * 3.5) :]
    centre = start[:3] + (0.05, 0.0, 0.0)
    radius = np.linalg.norm(places[:, :2] - centre[:2], axis=1)
    assert np.abs(radius - 0.05).max() < 2e-3
    assert np.abs(places[:, 2] - centre[2]).max() < 2e-3
    assert np.ptp(places[:, 1]) > 0.09


@pytest.mark.parametrize("arms", ARMS, ids=["one", "two"])
@pytest.mark.parametrize(("control", "relative"), MODES)
def test_a_hand_that_walks_away_and_engages_again_moves_nothing(
    lead: Lead, control: Any, relative: Any, arms: dict[str, Any]
) -> None:
    def walk(t: float) -> HandReading:
        place = at(min(0.1 * t, 0.05), np.clip(t - 1.5, 0.0, 1.0), 1.0)
        return held(place, *(("clutch",) if 0.3 <= t < 1.2 or t > 2.8 else ()))

    hands = arms.get("hands", ("right",))
    led = lead(both(walk, hands), control=control, relative=relative, **arms)
    led.run(1.5)
    before = led.tcp
    places = led.run(2.0)
    assert set(led.operator.states.values()) == {"engaged"}
    assert spread(places, before) < 1e-4


def test_no_two_targets_of_a_hand_at_72_hz_are_equal_at_90_hz(lead: Lead) -> None:
    led = lead(after(0.2, lambda t: at(0.1 * t, 0.0, 1.0)), frequency=90.0, control="tquat", relative="absolute")
    led.run(1.0)
    steps = np.abs(np.diff(np.array(led.targets[-60:])[:, :3], axis=0)).max(axis=1)
    assert steps.min() > 1e-5


def test_a_fast_hand_leads_at_the_largest_speed_and_leaves_no_way_to_go_on(lead: Lead) -> None:
    led = lead(after(0.2, lambda t: at(0.25 * np.sin(8.0 * min(t, 0.6)), 0.0, 1.0)), rate=200.0)
    places = led.run(0.8)
    speeds = np.linalg.norm(np.diff(places[:, :3], axis=0), axis=1) * 30
    assert 0.2 < speeds.max() <= 0.25
    led.run(0.7)
    assert spread(led.run(0.5), led.tcp) < 1e-3


def test_the_front_is_where_the_hand_points_at_the_button(lead: Lead) -> None:
    left = (0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4))

    def script(t: float) -> HandReading:
        place = at(0.0, 0.05 * np.clip(t - 0.5, 0.0, 1.0), 1.0, rotation=left)
        return held(place, *(("front",) if 0.1 < t < 0.2 else ()), *(("clutch",) if t > 0.4 else ()))

    led = lead(script)
    led.run(0.4)
    start = led.tcp
    led.run(1.5)
    np.testing.assert_allclose(led.tcp[:3] - start[:3], (0.05, 0.0, 0.0), atol=1e-3)


def test_the_front_that_one_hand_shows_is_that_of_both(lead: Lead) -> None:
    left = (0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4))

    def script(t: float) -> dict[str, HandReading]:
        way, clutch = 0.05 * np.clip(t - 0.5, 0.0, 1.0), ("clutch",) if t > 0.4 else ()
        shows = ("front",) if 0.1 < t < 0.2 else ()
        return {
            "left": held(at(0.0, way, 1.0), *clutch),  # type: ignore[arg-type]
            "right": held(at(0.0, way, 1.0, rotation=left), *shows, *clutch),  # type: ignore[arg-type]
        }

    led = lead(script, robot="dual_fr3", hands=("left", "right"))
    led.run(0.4)
    places = {name: guide.tcp_in_scene[:3] for name, guide in led.operator._guides.items()}
    led.run(1.5)
    for name, guide in led.operator._guides.items():
        guide.see(led.observation)
        np.testing.assert_allclose(guide.tcp_in_scene[:3] - places[name], (0.05, 0.0, 0.0), atol=2e-3)


def test_the_tcp_turns_as_the_hand_about_the_axes_of_the_room(lead: Lead) -> None:
    def turning(t: float) -> np.ndarray:
        angle = 0.3 * min(t, 1.0)
        return at(0.0, 0.0, 1.0, rotation=(np.sin(angle / 2), 0.0, 0.0, np.cos(angle / 2)))

    led = lead(after(0.3, turning))
    led.run(0.3)
    start = led.tcp
    led.run(2.0)
    turn = rcs.spatial.compose([0, 0, 0, *led.tcp[3:]], rcs.spatial.inverse([0, 0, 0, *start[3:]]))
    np.testing.assert_allclose(turn[3:], (np.sin(0.15), 0.0, 0.0, np.cos(0.15)), atol=5e-3)
    assert distance(led.tcp, start)[0] < 2e-3


@pytest.mark.parametrize("robot", ["so101"])
def test_an_arm_with_five_joints_follows_the_place_of_the_hand(lead: Lead, robot: str) -> None:
    led = lead(after(0.3, lambda t: at(0.03 * min(t, 1.0), 0.0, 1.0 + 0.03 * min(t, 1.0))), robot=robot)
    led.run(0.3)
    start = led.tcp
    led.run(2.0)
    np.testing.assert_allclose(led.tcp[:3] - start[:3], (0.03, 0.0, 0.03), atol=3e-3)


# --- Velocities -------------------------------------------------------------------------------------------------------


def test_a_wanted_velocity_is_that_of_the_tcp_and_a_small_one_is_none(lead: Lead) -> None:
    def script(t: float) -> HandReading:
        speed = 0.1 if t < 1.0 else 0.004
        return held(None, *(("clutch",) if t > 0.2 else ()), twist=np.array([0.0, speed, 0.0, 0.0, 0.0, 0.0]))

    led = lead(script, options=LeadOptions(deadband=0.0201))
    led.run(0.4)
    start = led.tcp
    led.run(0.5)
    way = led.tcp[:3] - start[:3]
    assert 0.03 < way[1] < 0.055
    assert np.abs(way[[0, 2]]).max() < 1e-3
    led.run(0.6)
    assert spread(led.run(0.5), led.tcp) < 2e-4


# --- Gripper ----------------------------------------------------------------------------------------------------------


def test_a_button_opens_and_closes_the_gripper_without_the_clutch(lead: Lead) -> None:
    led = lead(lambda t: held(LEVEL, *(("gripper",) if 0.2 < t % 1.0 < 0.4 else ())))
    led.run(1.1)
    assert led.observation["gripper"][0] < 0.1
    led.run(1.0)
    assert led.observation["gripper"][0] > 0.9


def test_an_opening_takes_over_where_it_meets_that_of_the_gripper(lead: Lead) -> None:
    def script(t: float) -> HandReading:  # closed at first, then wide open, then half closed
        opening = 0.2 if t < 0.8 else min(0.2 + 2.0 * (t - 0.8), 1.0) if t < 1.5 else 0.5
        return held(LEVEL, *(("clutch",) if t > 0.2 else ()), opening=opening)

    led = lead(script)
    led.run(0.7)
    assert led.observation["gripper"][0] > 0.9  # a hand that is closed while it engages does not close it
    led.run(1.5)
    assert led.observation["gripper"][0] == pytest.approx(0.5, abs=0.05)


def test_what_is_held_does_not_fall_at_the_end_of_a_take(lead: Lead) -> None:
    led = lead(lambda t: held(LEVEL, *(("gripper",) if 0.2 < t < 0.4 else ())))
    led.run(0.6)
    assert led.info["target"]["gripper"] == [0.0]
    around = {**led.observation, "gripper": np.array([0.4], np.float32)}
    led.operator.reset(around, led.info)
    assert led.operator.act(around, led.info)["gripper"] == [0.0]


# --- What does not fit ------------------------------------------------------------------------------------------------


def test_hands_that_do_not_fit_the_robots_are_refused() -> None:
    env = rcs.make("LiftBar", robot="dual_fr3")
    with pytest.raises(InvalidSetup, match="name the robot that each hand leads"):
        Operator(env, ScriptedDevice(lambda t: None, hands=("middle",)))
    with pytest.raises(UnknownName, match="middle"):
        Operator(env, ScriptedDevice(lambda t: None), robots={"middle": "left"})
    with pytest.raises(UnknownName, match="rihgt"):
        Operator(env, ScriptedDevice(lambda t: None), robots={"right": "rihgt"})
    with pytest.raises(InvalidSetup, match="a robot of its own"):
        Operator(env, ScriptedDevice(lambda t: None, hands=("left", "right")), robots={"left": "left", "right": "left"})


def test_synchronous_steps_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="not 'sync'"):
        Operator(rcs.make("Free", stepping="sync"), ScriptedDevice(lambda t: None))


def test_steps_that_are_too_rare_to_stop_in_time_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="10 Hz; valid for a person who leads is 20 Hz"):
        Operator(rcs.make("Free", frequency=10.0), ScriptedDevice(lambda t: None))


def test_what_was_left_out_is_told_with_its_number(lead: Lead) -> None:
    led = lead(lambda t: held(LEVEL if t < 0.2 else np.full(7, np.nan)))
    led.run(0.2)
    assert led.operator.problem == ""
    led.run(0.1)
    assert led.operator.problem == "left out: not finite 2"
    led.run(0.3)
    assert led.operator.problem.startswith("silent for 0.")
    assert "left out: not finite" in led.operator.problem


def test_one_hand_leads_the_robot_that_it_is_given_and_the_other_stays(lead: Lead) -> None:
    led = lead(after(0.3, lambda t: at(0.05 * min(t, 1.0), 0.0, 1.0)), robot="dual_fr3", robots={"right": "left"})
    led.run(0.3)
    start = {name: np.array(led.observation[name]["tquat"]) for name in ("left", "right")}
    led.run(1.6)
    ways = {name: distance(led.observation[name]["tquat"], start[name])[0] for name in start}
    assert ways["left"] == pytest.approx(0.05, abs=2e-3)
    assert ways["right"] < 1e-4


def test_one_robot_is_led_by_a_hand_and_the_other_by_another_agent(lead: Lead) -> None:
    led = lead(after(0.3, lambda t: at(0.05 * min(t, 1.0), 0.0, 1.0)), robot="dual_fr3", robots={"right": "left"})
    both = PerRobot(led.env, {"left": led.operator, "right": Nodding(led.env)})
    start = {name: np.array(led.observation[name]["joints"]) for name in ("left", "right")}
    tcp = np.array(led.observation["left"]["tquat"])
    both.reset(led.observation, led.info)
    for _ in range(60):
        led.observation, _, _, _, led.info = led.env.step(both.act(led.observation, led.info))
    assert distance(led.observation["left"]["tquat"], tcp)[0] == pytest.approx(0.05, abs=2e-3)
    assert led.observation["right"]["joints"][3] - start["right"][3] == pytest.approx(0.1, abs=5e-3)
    assert {note.name for note in both.note_fields} >= {"left/input_time", "left/right_state", "left/right_pose"}
    assert both.notes()["left/right_state"] == "engaged"


@pytest.mark.parametrize("is_takeover", [False, True])
def test_a_person_whose_hand_leads_another_robot_is_refused(is_takeover: bool) -> None:
    with rcs.make("Free", robot="dual_fr3") as env:
        person = Operator(env, ScriptedDevice(lambda t: None))  # its hand is the right one
        agent = Takeover(env, Nodding(env), person) if is_takeover else person
        with pytest.raises(InvalidSetup, match=r"robots=\{'right': 'left'\}"):
            PerRobot(env, {"left": agent, "right": Nodding(env)})
        PerRobot(env, {"left": Nodding(env), "right": agent})


@pytest.mark.parametrize(("kind", "size", "unit"), [("twist", 6, "m/s, rad/s"), ("joints", 7, "rad")])
def test_what_a_device_measures_is_noted_as_it_is(kind: Any, size: int, unit: str) -> None:
    measured = np.linspace(0.0, 0.1, size)
    device = ScriptedDevice(lambda t: held(None, **{kind: measured}))
    device.motion, device.valid_for = (kind, size), 2.0
    with rcs.make("Free", binary_gripper=False) as env:
        operator = Operator(env, device, has_thread=False)
        observation, info = env.reset(seed=0)
        operator.reset(observation, info)
        operator.act(observation, info)
        (field,) = [one for one in operator.note_fields if one.name == f"right_{kind}"]
        assert (field.size, field.unit) == (size, unit)
        np.testing.assert_array_equal(operator.notes()[field.name], measured)
        operator.close()


class Nodding(Agent):
    """Turns the elbow of the right robot by 0.1 rad."""

    def __init__(self, env: rcs.envs.Env) -> None:
        self.guide = Guide(env, env.robots["right"])

    def reset(self, observation: Any, info: Any) -> None:
        self.guide.reset(observation)
        joints = self.guide.joints
        joints[3] += 0.1
        self.guide.lead_joints_to(joints)

    def act(self, observation: Any, info: Any) -> dict[str, Any]:
        return self.guide.act(observation, info)


def test_a_loop_that_was_held_up_holds_until_the_clutch_is_pressed_anew(lead: Callable[..., Led]) -> None:
    is_pressed = [False]

    def script(t: float) -> HandReading:
        return held(at(0.0, 0.05 * t, 1.0), *(("clutch",) if is_pressed[0] else ()))

    led = lead(script, frequency=30.0)
    led.run(0.2)
    is_pressed[0] = True
    led.run(0.5)
    assert led.operator.states == {"right": "engaged"}
    world, held_up = led.env.simulation.world, [0.0]

    def clock() -> float:
        return float(world.time) + held_up[0]

    led.device.clock = led.operator._clock = led.operator.feed._clock = clock
    while held_up[0] < 1.0:  # meanwhile the device goes on, and the hand with it
        held_up[0] += 0.02
        led.operator.feed.poll()
    led.run(0.1)
    assert led.operator.states == {"right": "held"}
    assert "held up for 1.0" in led.operator.problem
    stopped = led.run(0.5)
    assert np.abs(stopped[5:, :3] - stopped[-1, :3]).max() < 1e-3
    is_pressed[0] = False
    led.run(0.2)
    is_pressed[0] = True
    led.run(1.0)
    assert led.operator.states == {"right": "engaged"}
    before, begin = led.tcp, held_up[0]
    while held_up[0] < begin + 1.0:  # the device goes on, and the clutch is released and pressed
        held_up[0] += 0.02
        is_pressed[0] = not 0.3 < held_up[0] - begin < 0.6
        reading = led.device.read()
        assert reading is not None
        led.operator.feed._take(reading)
    places = led.run(0.3)
    assert led.operator.states == {"right": "engaged"}
    assert places[:, 1].min() > before[1] - 2e-3  # it goes on from where it is, and not from where it stopped before


def test_requests_of_a_loop_that_was_held_up_keep_their_order_and_number(
    lead: Lead, monkeypatch: pytest.MonkeyPatch
) -> None:
    led = lead(lambda _: held(at(0.0, 0.0, 1.0)))
    pressed: list[Button] = ["success", "start", "takeover", "clutch", "takeover"]
    monkeypatch.setattr(led.operator.feed, "poll", lambda: News(pressed={"right": pressed}, requests=["stop"]))
    led.run(1.0 / led.env.frequency)
    assert led.operator.events() == ["success", "start", "takeover", "takeover", "stop"]
    assert led.operator.events() == []
