"""Robots that are driven in both simulations, to hold what sensors read against where they went."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from tb2rl.simulation import InitialState, find_simulator

PERIOD = 0.2  # [s] of a command


@pytest.fixture(params=("bullet", "kinematic"))
def drive(request, make_setup):
    """A function from a world, a pose and commands to the first reading and those after each command."""

    def readings(world, pose, commands):
        spec = make_setup(world, beams=3)
        start = InitialState.default(spec, 1)
        start.pose[:] = pose
        with closing(find_simulator(request.param).open(spec)) as simulation:
            first = simulation.reset(start, np.random.default_rng(0))
            return [first, *(simulation.step(np.array([command]), PERIOD) for command in commands)]

    return readings
