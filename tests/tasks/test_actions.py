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

# ---- named commands


def test_named_commands_are_numbered_in_their_order():
    assert NAMED.space == spaces.Discrete(3)
    assert NAMED.names == ("forward", "left", "right")
    assert (NAMED.forward, NAMED.left, NAMED.right) == (0, 1, 2)


def test_each_robots_number_tells_it_its_command():
    assert NAMED.commands(np.array([1, 0, 2, 1])).tolist() == [[0.05, 1], [0.5, 0], [0.05, -1], [0.05, 1]]
    assert NAMED.kinds(np.array([1, 0, 2])).tolist() == [1, 0, 2]


def test_an_action_that_was_not_named_is_not_there_and_the_names_are_said():
    with pytest.raises(AttributeError, match="no action 'backward'; there are forward, left, right"):
        _ = NAMED.backward


def test_more_commands_come_after_the_present_ones_which_stay():
    more = NAMED.plus(backward=(-0.1, 0.0))
    assert more.names == ("forward", "left", "right", "backward")
    assert (more.backward, more.left, more.space.n) == (3, 1, 4)
    assert more.commands(np.array([3, 1])).tolist() == [[-0.1, 0], [0.05, 1]]
    assert NAMED.space.n == 3


@pytest.mark.parametrize("action", [2, np.int64(2), np.int32(2), np.array(2)])
def test_any_integer_within_the_names_is_an_action(action):
    assert NAMED.checked(action).tolist() == [2]


@pytest.mark.parametrize("action", [3, -1, 10**30, np.nan, 0.0, np.float32(1), "0", None, [0], np.array([0, 1])])
def test_what_is_not_a_number_of_a_command_is_refused_with_one_line(action):
    with pytest.raises(InputError, match="not one of the integers 0 to 2") as error:
        NAMED.checked(action)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ((0.4, 0.1), "forward"),
        ((9.0, 0.0), "forward"),
        ((0.0, 0.9), "left"),
        ((0.1, -3.0), "right"),
        ((0.1, 0.3), "left"),  # half the largest speed counts as much as half the largest turn rate
        ((0.3, 0.3), "forward"),
    ],
)
def test_the_command_most_like_another_one_is_found(command, name):
    assert NAMED.names[NAMED.nearest(np.array(command))] == name


def test_a_named_command_is_described_by_its_name():
    assert [NAMED.describe(action) for action in (0, np.int64(1), np.array(2))] == ["forward", "left", "right"]


def test_the_fastest_command_counts_backwards_too():
    assert NAMED.max_speed == 0.5
    assert Commands(back=(-0.7, 0.0), on=(0.5, 0.0)).max_speed == 0.7


def test_no_command_at_all_is_refused():
    with pytest.raises(InputError, match="at least one action"):
        Commands()


@pytest.mark.parametrize("name", ["space", "names", "table", "max_speed", "within", "plus", "commands", "nearest"])
def test_a_name_that_means_something_else_is_refused(name):
    with pytest.raises(InputError, match=f"an action cannot be called '{name}'"):
        Commands(forward=(0.5, 0.0), **{name: (0.1, 0.0)})


@pytest.mark.parametrize("actions", [NAMED, ANY], ids=["named", "any"])
def test_actions_travel_to_other_processes(actions):
    again = pickle.loads(pickle.dumps(actions))
    assert (again.space, again.names, again.max_speed) == (actions.space, actions.names, actions.max_speed)


# ---- within what a robot can do


@pytest.mark.parametrize("actions", [NAMED, ANY], ids=["named", "any"])
def test_what_a_robot_can_do_stays_to_the_bit(actions):
    some = np.arange(3) if actions is NAMED else np.random.default_rng(0).uniform(-1, 1, (100, 2))
    np.testing.assert_array_equal(actions.within(TURTLEBOT2).commands(some), actions.commands(some))
    assert actions.within(TURTLEBOT2).max_speed == actions.max_speed == 0.5


def test_named_commands_are_cut_to_what_a_robot_can_do():
    cut = NAMED.plus(back=(-0.7, 9.0)).within(BURGER)
    assert cut.commands(np.arange(4)).tolist() == [[0.22, 0.0], [0.05, 1.0], [0.05, -1.0], [-0.22, 2.84]]
    assert (cut.names, cut.back, cut.space.n, cut.max_speed) == (("forward", "left", "right", "back"), 3, 4, 0.22)
    assert NAMED.max_speed == 0.5


def test_minus_one_to_one_spans_what_a_robot_can_do():
    cut = Velocities(forward=(-0.1, 0.5), turn=(-2.0, 9.0)).within(BURGER)
    ends = cut.commands(np.array([(-1.0, -1.0), (1.0, 1.0), (0.0, 0.0)]))
    assert ends == pytest.approx(np.array([(-0.1, -2.0), (0.22, 2.84), (0.06, 0.42)]))
    assert (cut.space, cut.max_speed) == (ANY.space, 0.22)
    assert cut.commands(cut.nearest(np.array((0.2, 0.0)))[None])[0] == pytest.approx((0.2, 0.0), abs=1e-6)
    assert ANY.max_speed == 0.5


# ---- any velocities


def test_velocities_are_two_numbers_from_minus_one_to_one():
    assert spaces.Box(-1, 1, (2,), np.float32) == ANY.space


@pytest.mark.parametrize(
    ("action", "command"),
    [
        ((-1, -1), (-0.1, -2.0)),
        ((1, 1), (0.5, 2.0)),
        ((0, 0), (0.2, 0.0)),
        ((0.5, -0.5), (0.35, -1.0)),
        ((9, -9), (0.5, -2.0)),  # cut to the ends
    ],
)
def test_the_ends_of_the_ranges_are_minus_one_and_one(action, command):
    assert ANY.commands(np.array([action], dtype=np.float32))[0] == pytest.approx(command)


def test_several_robots_are_told_a_row_each():
    assert ANY.commands(np.array([(-1, 1), (1, -1)])) == pytest.approx(np.array([(-0.1, 2.0), (0.5, -2.0)]))


@pytest.mark.parametrize("command", [(-0.1, 2.0), (0.2, 0.0), (0.35, -1.3)])
def test_the_nearest_action_to_a_command_within_the_ranges_is_that_command(command):
    action = ANY.nearest(np.array(command))
    assert ANY.space.contains(action)
    assert ANY.commands(action[None])[0] == pytest.approx(command, abs=1e-6)


def test_the_nearest_action_to_a_command_beyond_the_ranges_is_at_their_ends():
    assert ANY.nearest(np.array((9.0, -9.0))).tolist() == [1.0, -1.0]


def test_a_range_that_is_a_single_value_is_that_value():
    straight = Velocities(forward=(0.3, 0.3), turn=(-1.0, 1.0))
    assert straight.commands(np.array([[-1.0, 0.0], [1.0, 0.0]])) == pytest.approx(np.array([[0.3, 0.0]] * 2))
    assert straight.space.contains(straight.nearest(np.array((0.3, 0.5))))


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ((0.5, 0.0), "forward"),
        ((0.5, 0.4), "forward"),  # a bend is not yet a turn
        ((0.5, 0.6), "left"),
        ((0.0, -0.6), "right"),
        ((0.1, 0.0), "stand"),
        ((-0.1, 0.0), "stand"),
        ((0.0, 0.0), "stand"),
    ],
)
def test_velocities_are_of_a_kind(command, kind):
    action = ANY.nearest(np.array(command))
    assert ANY.names[ANY.kinds(action[None])[0]] == kind


def test_going_back_is_a_kind_too():
    both_ways = Velocities(forward=(-0.5, 0.5), turn=(-1.0, 1.0))
    kinds = both_ways.kinds(np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, 0.0)]))
    assert [both_ways.names[kind] for kind in kinds] == ["backward", "forward", "left", "stand"]


def test_velocities_are_described_by_their_numbers():
    assert ANY.describe(ANY.nearest(np.array((0.31, -0.2)))) == "0.31, -0.20"
    assert ANY.max_speed == 0.5


@pytest.mark.parametrize("action", [(0.5, -0.5), [1, -1], np.array([0.5, 0.5], np.float32)])
def test_two_numbers_are_an_action(action):
    assert ANY.checked(action).tolist() == [list(action)]


@pytest.mark.parametrize(
    "action", [0, 0.5, None, "ab", (1.0,), (1.0, 1.0, 1.0), [[0.0, 0.0]], (math.nan, 0.0), (math.inf, 0)]
)
def test_what_is_not_two_numbers_is_refused_with_one_line(action):
    with pytest.raises(InputError, match="not two numbers from -1 to 1") as error:
        ANY.checked(action)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("wrong", [0.3, (0.3,), (0.3, 0.0, 0.0), ("fast", 0.0), (0.3, np.nan), None])
def test_a_command_that_is_not_two_numbers_is_refused_by_its_name(wrong):
    with pytest.raises(InputError, match=r"action 'forward' needs two numbers, v \[m/s\] and w \[rad/s\], got"):
        Commands(left=(0.0, 1.0), forward=wrong)


@pytest.mark.parametrize("wrong", [0.5, (0.5,), ("slow", "fast"), (0.0, np.inf)])
def test_a_range_that_is_not_two_numbers_is_refused_by_its_name(wrong):
    with pytest.raises(InputError, match="action 'forward' needs two numbers, the slowest and the fastest"):
        Velocities(forward=wrong, turn=(-1.0, 1.0))
    with pytest.raises(InputError, match="action 'turn' needs two numbers, the least and the largest"):
        Velocities(forward=(0.0, 0.5), turn=wrong)


def test_a_range_takes_its_smaller_number_first():
    with pytest.raises(InputError, match=r"smaller number first, got forward=\(0.5, 0.0\)"):
        Velocities(forward=(0.5, 0.0), turn=(-1.0, 1.0))
