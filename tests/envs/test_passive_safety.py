"""The passive safety filter: a robot stands before something that moves arrives, and drives past what stands."""

import math
from collections import Counter

import numpy as np
import pytest

from tb2rl import evaluate
from tb2rl.core.errors import InputError
from tb2rl.envs import passive_safety, safe_motion, safety
from tb2rl.envs.filters import SensedState
from tb2rl.envs.parts import robot_facts
from tb2rl.envs.passive_safety import PassiveSafety
from tb2rl.envs.safety import REASONS, Safety
from tb2rl.envs.scene import make_scene
from tb2rl.tasks.drive import Drive
from tb2rl.tasks.navigate import Navigate

PEOPLE = {"people": 8, "speed": [0.3, 1.0]}
POLICY = "zoo:navigate-plan-ppo"
RADIUS, ROOM = 0.25, 4.0  # [m] of a person; distance of the walls


@pytest.fixture
def make_filter():
    """A function that makes a filter for robots that stand in the middle of a room, and a function that asks it."""

    def make(cls=PassiveSafety, num_envs=1, **task):
        task = Drive(**{"variation": "none", "beams": 121, "control_period": 0.1, **task})
        scene = make_scene(task, "raw")
        command_filter, angles = cls(robot_facts(task, scene.spec)), scene.laser.angles
        command_filter.reset(num_envs)

        def ask(*people, command=(0.6, 0.2), yaw=0.0):
            """The filtered command of the last robot, which sees people at x, y [m]; the others see none."""
            ranges = np.full((num_envs, len(angles)), ROOM)
            for x, y in people:
                ranges[-1] = np.minimum(ranges[-1], ranges_of_person(x, y, angles + yaw))
            zeros, pose = np.zeros((num_envs, 2)), np.tile([0.0, 0.0, yaw], (num_envs, 1))
            sensed = SensedState(ranges, pose, zeros, np.zeros(num_envs, bool), zeros, np.zeros(num_envs))
            return command_filter(np.tile(command, (num_envs, 1)), sensed)[-1].tolist()

        return ask, command_filter

    return make


def ranges_of_person(x, y, angles):
    """Ranges of a round person at x, y [m], inf where the beams miss."""
    ahead, left = x * np.cos(angles) + y * np.sin(angles), y * np.cos(angles) - x * np.sin(angles)
    hit = (np.abs(left) < RADIUS) & (ahead > 0.0)
    return np.where(hit, ahead - np.sqrt(np.maximum(RADIUS**2 - left**2, 0.0)), np.inf)


def approach(ask, start=1.5, end=0.55, angle=0.0, **others):
    """A person comes closer at 1 m/s; returns the last command."""
    for distance in np.arange(start, end, -0.1):
        command = ask((distance * math.cos(angle), distance * math.sin(angle)), **others)
    return command


def test_a_robot_stands_before_a_person_who_comes_and_not_before_one_who_stands(make_filter):
    ask, command_filter = make_filter()
    assert approach(ask) == [0.0, 0.2]
    assert command_filter.reason(0) == REASONS[1]
    for cls in (PassiveSafety, Safety):
        ask, command_filter = make_filter(cls)
        for _ in range(10):
            assert ask((0.75, 0.0))[0] > 0.2
    assert approach(ask)[0] > 0.2, "the plain filter takes all obstacles as static"


@pytest.mark.parametrize("angle", [-1.4, 1.4])
def test_it_does_not_drive_along_a_person_who_has_stopped_at_its_side_but_turns(make_filter, angle):
    ask, _ = make_filter()
    approach(ask, end=0.45, angle=angle)
    beside = 0.45 * math.cos(angle), 0.45 * math.sin(angle)
    for _ in range(40):
        assert ask(beside) == [0.0, 0.2]
    for _ in range(20):
        command = ask(beside)
    assert command[0] > 0.0, "five seconds later it is an obstacle like others"
    approach(ask, end=0.45, angle=angle)
    assert ask(beside, yaw=-math.copysign(1.0, angle))[0] > 0.0, "it has turned until the person is behind it"


def test_turning_makes_no_wall_move(make_filter):
    ask, command_filter = make_filter()
    corner = [(1.2 + 0.1 * step, 0.6 - 0.1 * step) for step in range(6)]
    for yaw in np.arange(0.0, 1.5, 0.1):
        ask(*corner, yaw=yaw)
        assert command_filter.reason(0) == ""


def test_what_moves_behind_a_robot_matters_only_if_it_drives_backwards(make_filter):
    robot = {"base": "turtlebot2", "laser": {"beams": 360, "field_of_view": math.tau}}
    ask, _ = make_filter(robot=robot, field_of_view=math.tau)
    assert approach(ask, angle=math.pi) == [0.6, 0.2]
    assert ask((-0.55, 0.0), command=(-0.2, 0.2)) == [0.0, 0.2]
    assert approach(ask, angle=1.0) == [0.0, 0.2]


def test_episodes_begin_without_memory_and_go_on_from_a_copy(make_filter):
    ask, command_filter = make_filter(num_envs=2)
    approach(ask)
    again, copied = make_filter(num_envs=2)
    copied.restore(command_filter.state())
    assert again((0.55, 0.0)) == ask((0.55, 0.0)) == [0.0, 0.2]
    command_filter.reset_at(np.array([1]))
    assert ask((0.75, 0.0))[0] > 0.2
    assert again((0.55, 0.0)) == [0.0, 0.2]


@pytest.mark.slow
def test_a_policy_that_never_saw_people_causes_a_third_of_the_contacts():
    contacts = {}
    for filters in ((), ("passive_safety",)):
        settings = {"dynamic_obstacles": PEOPLE, "filters": filters}
        evaluation = evaluate(POLICY, settings=settings, episodes=150, steps=600, seed=5, simulation="kinematic")
        endings = Counter(episode.ended for episode in evaluation.episodes)
        contacts[filters] = endings["collision with a dynamic obstacle"]
    assert contacts[()] > 30
    assert contacts["passive_safety",] < contacts[()] / 3


def test_a_speed_that_makes_no_sense_is_named():
    with pytest.raises(InputError, match=r"obstacle_speed must be above 0 m/s, got -1"):
        make_scene(Navigate(filters=({"passive_safety": {"obstacle_speed": -1}},)), "raw")


def test_compiled_and_plain_code_decide_alike(make_filter, monkeypatch):
    (ask, _), (again, _) = make_filter(beams=60), make_filter(beams=60)
    random = np.random.default_rng(3)
    crowds = np.clip(np.cumsum(random.normal(0.0, 0.08, (60, 3, 2)), axis=0) + [[1, 0], [0.5, 1], [0.5, -1]], 0.4, 3)
    commands = [ask(*people) for people in crowds]
    for module in (passive_safety, safe_motion, safety):
        for name in vars(module):
            if hasattr(getattr(module, name), "py_func"):
                monkeypatch.setattr(module, name, getattr(module, name).py_func)
    np.testing.assert_allclose(commands, [again(*people) for people in crowds], atol=1e-9)
    assert 0.1 < np.mean([command[0] < 0.6 for command in commands]) < 0.99
