"""Robot states of an episode in each simulator, to compare sensors with the true motion."""

from contextlib import closing

import numpy as np
import pytest

from tb2rl.simulation import InitialState, find_simulator

PERIOD = 0.2  # [s] of a command


@pytest.fixture(params=("bullet", "mujoco", "kinematic"))
def drive(request, make_spec):
    """A function from a world, a pose and commands to the first robot state and those after each command."""

    def robot_states(world, pose, commands):
        spec = make_spec(world, beams=3)
        initial_state = InitialState.default(spec, 1)
        initial_state.pose[:] = pose
        with closing(find_simulator(request.param).open(spec)) as simulator:
            first = simulator.reset(initial_state, np.random.default_rng(0))
            return [first, *(simulator.step(np.array([command]), PERIOD) for command in commands)]

    return robot_states
