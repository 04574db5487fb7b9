"""What an agent observes of a reading: distance classes or ranges, and the task's senses."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from tb2rl.errors import InputError
from tb2rl.observations import OBSERVATIONS, observe_as, ranges_to_bins
from tb2rl.registry import find_task, task_names
from tb2rl.settings import build, read_yaml, room
from tb2rl.simulation import Reading
from tb2rl.tasks import Sense
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander

INF, NAN = math.inf, math.nan


def reading(ranges, odometry=(0.0, 0.0, 0.0)):
    """A reading with ranges (robots, beams) or (beams,)."""
    ranges = np.atleast_2d(np.array(ranges, dtype=float))
    poses = np.broadcast_to(np.array(odometry, dtype=float), (len(ranges), 3))
    return Reading(poses, np.zeros((len(ranges), 2)), poses, ranges, np.zeros(len(ranges), dtype=bool))


@dataclass(frozen=True)
class Sensing(Wander):
    """A task whose sense is the robot's odometry in x."""

    @property
    def senses(self):
        return (Sense("x", -1.0, 1.0, edges=(0.0, 0.5)),)

    def sense(self, reading):
        return reading.odometry[:, :1]


def test_ranges_fall_into_classes_whose_lower_border_belongs_to_them():
    ranges = np.array([[0.0, 0.999, 1.0, 1.001, 1.999], [2.0, 29.0, INF, NAN, -INF]])
    assert ranges_to_bins(ranges, [1.0, 2.0]).tolist() == [[0, 0, 1, 1, 1], [2, 2, 2, 0, 0]]


def test_the_tutorials_classes_are_the_integer_part():
    edges = read_yaml(room("configs") / "tutorial.yaml")["task"]["edges"]
    ranges = np.array([NAN, 0.0, 0.999, 1.0, 2.5, 5.999, 6.0, 7.3, INF])
    assert ranges_to_bins(ranges, edges).tolist() == [0, 0, 0, 1, 2, 5, 6, 6, 6]


def test_the_tutorial_observes_five_of_720_beams_in_seven_classes():
    settings = read_yaml(room("configs") / "tutorial.yaml")["task"]
    task = build(find_task(settings.pop("name")), settings, "task")
    observe, laser = observe_as("discrete", task)
    assert laser.beams == 720
    assert observe.space.nvec.tolist() == [7] * 5


@pytest.mark.parametrize("mode", OBSERVATIONS)
@pytest.mark.parametrize("name", task_names())
def test_every_observation_of_every_task_lies_in_its_space(name, mode):
    task, rng = find_task(name)(), np.random.default_rng(0)
    task = ReachGoal(goal=(1.0, 2.0)) if isinstance(task, ReachGoal) else task
    observe, laser = observe_as(mode, task)
    for _ in range(20):
        ranges = rng.choice([laser.min_range, 0.7, 1.0, rng.uniform(0.1, 30), laser.max_range, INF], len(laser.angles))
        assert observe.space.contains(observe(reading(ranges, rng.uniform(-9, 9, 3)))[0])


def test_distance_classes_of_several_robots_are_rows():
    observe, _ = observe_as("discrete", Wander(beams=3, edges=(1.0, 2.0)))
    seen = observe(reading([[0.5, 1.5, INF], [INF, INF, 0.1]]))
    assert seen.tolist() == [[0, 1, 2], [2, 2, 0]]
    assert np.issubdtype(seen.dtype, np.integer)


def test_raw_ranges_are_metres_in_float32_and_nothing_hit_is_the_longest():
    observe, laser = observe_as("raw", Wander(beams=3))
    seen = observe(reading([[0.5, 1.25, INF], [29.0, 31.0, 0.1]]))
    assert seen.dtype == np.float32
    assert seen == pytest.approx(np.array([[0.5, 1.25, laser.max_range], [29, laser.max_range, 0.1]]))


@pytest.mark.parametrize("mode", OBSERVATIONS)
def test_the_number_of_beams_is_a_setting_and_so_are_the_ones_kept(mode):
    for settings, beams in (
        ({"beams": 12}, 12),
        ({"beams": 12, "kept": (0, 5, 11)}, 3),
        ({}, OBSERVATIONS[mode].beams),
    ):
        observe, laser = observe_as(mode, Wander(**settings))
        assert observe.space.shape == laser.angles.shape == (beams,)


def test_senses_come_after_the_beams_in_the_classes_of_their_own_edges():
    observe, _ = observe_as("discrete", Sensing(beams=2, edges=(1.0,)))
    assert observe.space.nvec.tolist() == [2, 2, 3]
    assert [observe(reading([[0.5, 2.0]], (x, 0, 0)))[0].tolist() for x in (-1, 0, 0.7)] == [
        [0, 1, 0],
        [0, 1, 1],
        [0, 1, 2],
    ]


@pytest.mark.parametrize(("x", "seen"), [(-0.5, -0.5), (0.25, 0.25), (9.0, 1.0), (-9.0, -1.0)])
def test_raw_senses_come_after_the_beams_cut_to_their_limits(x, seen):
    observe, _ = observe_as("raw", Sensing(beams=2))
    assert (observe.space.low[-1], observe.space.high[-1]) == (-1, 1)
    assert observe(reading([[0.5, 2.0]], (x, 0, 0)))[0].tolist() == [0.5, 2.0, seen]


@pytest.mark.parametrize(
    ("mode", "task", "words"),
    [
        ("rew", Wander(), ["unknown observation 'rew'", "did you mean 'raw'", "discrete"]),
        ("discrete", Wander(edges=(1.0, 1.0)), ["task.edges must strictly increase", "[1.0, 1.0]"]),
        ("discrete", Wander(edges=(2.0, 1.0)), ["task.edges must strictly increase"]),
        ("discrete", ReachGoal(goal=(1, 1), bearing_edges=(1.0, 0.0)), ["bearing", "must strictly increase"]),
        ("raw", Wander(beams=720, kept=(0, 720)), ["task.kept names beam 720", "720 beams"]),
        ("discrete", Wander(kept=(7,)), ["task.kept names beam 7", "7 beams"]),
    ],
)
def test_an_observation_that_cannot_be_is_refused(mode, task, words):
    with pytest.raises(InputError) as error:
        observe_as(mode, task)
    for word in words:
        assert word in str(error.value)
