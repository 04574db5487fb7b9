"""Worlds of many obstacles, and many worlds, are not slow; by the time of the processor, as others may use it too."""

import time

import numpy as np
import pytest

from tb2rl.registry import find_world
from tb2rl.simulation import Start
from tb2rl.simulation.kinematic import KinematicSimulation
from tb2rl.worlds import World

ROBOTS = 512


def posts_between(count, seed):
    """A square of so many posts with a robot's start in its middle, as dense as in BARN."""
    rng, side = np.random.default_rng(seed), 0.4 * np.sqrt(count)
    places = rng.uniform(-side / 2, side / 2, (2 * count, 2))
    places = places[np.hypot(*places.T) > 0.4][:count]
    return World.from_shapes("posts", [], [(x, y, 0.075) for x, y in places], start=(0.0, 0.0, 0.0))


def seconds_of(work, times=15):
    """The least processor time that some work takes [s], after a first time."""
    taken = []
    for _ in range(times + 1):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return min(taken[1:])


def seconds_of_a_step(worlds, make_setup):
    setup, rng = make_setup(*worlds, beams=36), np.random.default_rng(0)
    simulation = KinematicSimulation(setup, ROBOTS)
    start = Start.proposed(setup, ROBOTS, rng.integers(len(worlds), size=ROBOTS))
    start.pose[:, 2] = rng.uniform(-3, 3, ROBOTS)
    simulation.reset(start, rng)
    turns = np.column_stack([np.zeros(ROBOTS), rng.uniform(-1, 1, ROBOTS)])
    return seconds_of(lambda: simulation.step(turns, 0.2))


def test_robots_in_512_worlds_are_nearly_as_fast_as_in_one(make_setup):
    worlds = [posts_between(30, seed) for seed in range(512)]
    assert seconds_of_a_step(worlds[:1], make_setup) > 0.85 * seconds_of_a_step(worlds, make_setup)


@pytest.mark.parametrize("count", [250, 5000])
def test_many_obstacles_cost_a_few_times_as_much_as_30(count, make_setup):
    few, many = ([posts_between(number, 0)] for number in (30, count))
    assert seconds_of_a_step(many, make_setup) < 6 * seconds_of_a_step(few, make_setup)


def test_a_step_of_pybullet_among_250_posts_costs_at_most_half_more_than_in_loop(make_setup, make_bullet):
    setup = make_setup(find_world("loop"), posts_between(250, 0), beams=36)
    simulation, rng = make_bullet(setup), np.random.default_rng(0)

    def step():
        simulation.advance(20)

    seconds = []
    for world in (0, 1):
        simulation.reset(Start.proposed(setup, 1, world=world), rng)
        simulation.step(np.array([[0.0, 0.5]]), 0.2)
        seconds.append(seconds_of(step, times=40))
    assert seconds[1] < 1.5 * seconds[0]
