"""Actions: named commands, and any velocities within a range."""

import math
import pickle

import numpy as np
import pytest
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT as TURTLEBOT2
from tb2rl.robots.turtlebot3 import ROBOT as BURGER
from tb2rl.tasks import Commands, Velocities

NAMED = Commands(forward=(0.5, 0.0), left=(0.05, 1.0), right=(0.05, -1.0))
ANY = Velocities(forward=(-0.1, 0.5), turn=(-2.0, 2.0))


def test_named_commands_are_numbered_in_their_order():
    assert NAMED.space == spaces.Discrete(3)
    assert NAMED.names == ("forward", "left", "right")
    assert (NAMED.forward, NAMED.left, NAMED.right) == (0, 1, 2)
    assert NAMED.commands(np.array([1, 0, 2, 1])).tolist() == [[0.05, 1], [0.5, 0], [0.05, -1], [0.05, 1]]
    assert NAMED.kinds(np.array([1, 0, 2])).tolist() == [1, 0, 2]
    assert [NAMED.describe(action) for action in (0, np.int64(1), np.array(2))] == ["forward", "left", "right"]
    with pytest.raises(AttributeError, match="no action 'backward'; there are forward, left, right"):
        _ = NAMED.backward


def test_any_integer_below_their_number_is_an_action_and_any_two_numbers_are():
    for action in (2, np.int32(2), np.array(2)):
        assert NAMED.checked(action).tolist() == [2]
    assert ANY.checked((0.5, 1)).tolist() == [[0.5, 1.0]]


@pytest.mark.parametrize(
    ("actions", "words", "wrong"),
    [
        (NAMED, "not one of the integers 0 to 2", [3, -1, 10**30, np.nan, 0.0, "0", None, np.array([0, 1])]),
        (ANY, "not two numbers from -1 to 1", [0, None, "ab", (1.0, 1.0, 1.0), [[0.0, 0.0]], (math.nan, 0.0)]),
    ],
)
def test_an_action_outside_the_space_is_refused_in_one_line(actions, words, wrong):
    for action in wrong:
        with pytest.raises(InputError, match=words) as error:
            actions.checked(action)
        assert "\n" not in str(error.value)


def test_commands_are_cut_to_the_limits_of_a_robot():
    cut = NAMED.plus(back=(-0.7, 9.0)).clipped_to(BURGER)
    assert cut.commands(np.arange(4)).tolist() == [[0.22, 0.0], [0.05, 1.0], [0.05, -1.0], [-0.22, 2.84]]
    assert (cut.names, cut.back, cut.max_speed, NAMED.max_speed) == (("forward", "left", "right", "back"), 3, 0.22, 0.5)
    cut = Velocities(forward=(-0.1, 0.5), turn=(-2.0, 9.0)).clipped_to(BURGER)
    ends = cut.commands(np.array([(-1.0, -1.0), (1.0, 1.0), (0.0, 0.0)]))
    assert ends == pytest.approx(np.array([(-0.1, -2.0), (0.22, 2.84), (0.06, 0.42)]))


def test_the_nearest_action_to_a_command_is_found():
    commands = [(0.4, 0.1), (9.0, 0.0), (0.0, 0.9), (0.1, -3.0), (0.1, 0.3), (0.3, 0.3)]
    found = [NAMED.names[NAMED.nearest(np.array(command))] for command in commands]
    # half the largest speed counts as much as half the largest turn rate
    assert found == ["forward", "forward", "left", "right", "left", "forward"]


@pytest.mark.parametrize("name", ["space", "clipped_to"])
def test_a_name_that_means_something_else_is_refused(name):
    with pytest.raises(InputError, match=f"an action cannot have the name '{name}'"):
        Commands(forward=(0.5, 0.0), **{name: (0.1, 0.0)})
    with pytest.raises(InputError, match="at least one action"):
        Commands()


def test_minus_one_and_one_are_the_ends_of_the_ranges():
    assert spaces.Box(-1, 1, (2,), np.float32) == ANY.space
    actions = np.array([(-1, -1), (1, 1), (0, 0), (0.5, -0.5), (9, -9)], dtype=np.float32)
    commands = [(-0.1, -2.0), (0.5, 2.0), (0.2, 0.0), (0.35, -1.0), (0.5, -2.0)]  # the last is clipped
    assert ANY.commands(actions) == pytest.approx(np.array(commands))
    assert ANY.max_speed == 0.5


@pytest.mark.parametrize("command", [(-0.1, 2.0), (0.2, 0.0), (0.35, -1.3)])
def test_the_nearest_action_to_a_command_within_the_ranges_is_that_command(command):
    action = ANY.nearest(np.array(command))
    assert ANY.space.contains(action)
    assert ANY.commands(action[None])[0] == pytest.approx(command, abs=1e-6)
    assert ANY.nearest(np.array((9.0, -9.0))).tolist() == [1.0, -1.0]


def test_velocities_are_of_a_kind_and_described_by_their_numbers():
    kinds = {(0.5, 0.0): "forward", (0.5, 0.4): "forward", (0.5, 0.6): "left", (0.0, -0.6): "right"}
    kinds |= {(0.1, 0.0): "stand", (-0.1, 0.0): "stand", (0.0, 0.0): "stand"}
    actions = np.array([ANY.nearest(np.array(command)) for command in kinds])
    assert [ANY.names[kind] for kind in ANY.kinds(actions)] == list(kinds.values())
    both_ways = Velocities(forward=(-0.5, 0.5), turn=(-1.0, 1.0))
    assert both_ways.names[both_ways.kinds(np.array([(-1.0, 0.0)]))[0]] == "backward"
    assert ANY.describe(ANY.nearest(np.array((0.31, -0.2)))) == "0.31, -0.20"


@pytest.mark.parametrize("wrong", [0.5, ("slow", "fast"), (0.0, np.inf)])
def test_what_is_not_two_numbers_is_refused_by_its_name(wrong):
    with pytest.raises(InputError, match=r"action 'forward' needs two numbers, v \[m/s\] and w \[rad/s\], got"):
        Commands(left=(0.0, 1.0), forward=wrong)
    with pytest.raises(InputError, match="action 'forward' needs two numbers, the slowest and the fastest"):
        Velocities(forward=wrong, turn=(-1.0, 1.0))
    with pytest.raises(InputError, match="action 'turn' needs two numbers, the least and the largest"):
        Velocities(forward=(0.0, 0.5), turn=wrong)
    with pytest.raises(InputError, match=r"smaller number first, got forward=\(0.5, 0.0\)"):
        Velocities(forward=(0.5, 0.0), turn=(-1.0, 1.0))


@pytest.mark.parametrize("actions", [NAMED, ANY], ids=["named", "any"])
def test_commands_within_the_limits_stay_to_the_bit_and_actions_can_be_pickled(actions):
    some = np.arange(3) if actions is NAMED else np.random.default_rng(0).uniform(-1, 1, (100, 2))
    for same in (actions.clipped_to(TURTLEBOT2), pickle.loads(pickle.dumps(actions))):
        np.testing.assert_array_equal(same.commands(some), actions.commands(some))
        assert (same.space, same.names, same.max_speed) == (actions.space, actions.names, 0.5)
