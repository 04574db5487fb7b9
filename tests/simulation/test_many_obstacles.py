"""Worlds of many obstacles, and many worlds, are not slow; by the time of the processor, as others may use it too."""

import time

import numpy as np
import pytest

from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world

ROBOTS = 512


def posts_between(count, seed):
    """A square of so many posts with a robot's start in its middle, as dense as in BARN."""
    rng, side = np.random.default_rng(seed), 0.4 * np.sqrt(count)
    places = rng.uniform(-side / 2, side / 2, (2 * count, 2))
    places = places[np.hypot(*places.T) > 0.4][:count]
    return World.from_shapes("posts", [], [(x, y, 0.075) for x, y in places], start=(0.0, 0.0, 0.0))


def seconds_of(works, times=20):
    """The least processor time that each of some works takes [s], in turns and after a first time."""
    taken = np.empty((times + 1, len(works)))
    for row in taken:
        for number, work in enumerate(works):
            start = time.process_time()
            work()
            row[number] = time.process_time() - start
    return taken[1:].min(axis=0)


def step_in(worlds, make_setup):
    """A step of robots at the starts of some worlds, which turn on the spot."""
    spec, rng = make_setup(*worlds, beams=36), np.random.default_rng(0)
    simulation = KinematicSimulator(spec, ROBOTS)
    start = InitialState.default(spec, ROBOTS, rng.integers(len(worlds), size=ROBOTS))
    start.pose[:, 2] = rng.uniform(-3, 3, ROBOTS)
    simulation.reset(start, rng)
    turns = np.column_stack([np.zeros(ROBOTS), rng.uniform(-1, 1, ROBOTS)])
    return lambda: simulation.step(turns, 0.2)


def test_robots_in_512_worlds_are_nearly_as_fast_as_in_one(make_setup):
    worlds = [posts_between(30, seed) for seed in range(512)]
    one, many = seconds_of([step_in(worlds[:1], make_setup), step_in(worlds, make_setup)])
    assert one > 0.8 * many


@pytest.mark.parametrize("count", [250, 5000])
def test_many_obstacles_cost_a_few_times_as_much_as_30(count, make_setup):
    few, many = seconds_of([step_in([posts_between(number, 0)], make_setup) for number in (30, count)])
    assert many < 6 * few


def test_a_step_of_pybullet_among_250_posts_costs_at_most_half_more_than_in_loop(make_setup, make_bullet):
    steps = []
    for world in (find_world("loop"), posts_between(250, 0)):
        simulation = make_bullet(make_setup(world, beams=36))
        simulation.reset(InitialState.default(simulation.spec, 1), np.random.default_rng(0))
        simulation.step(np.array([[0.0, 0.5]]), 0.2)
        steps.append(simulation.advance)
    loop, posts = seconds_of(steps, times=60)
    assert posts < 1.5 * loop
