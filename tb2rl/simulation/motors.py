"""Measures the acceleration of a robot's wheels in a physics simulator, for the kinematic simulator."""

from contextlib import closing
from dataclasses import replace

import numpy as np

from tb2rl.robots import Robot
from tb2rl.simulation.simulator import SimulatorType, default_physics
from tb2rl.simulation.spec import PHYSICS_RATE, InitialState, SimulationSpec
from tb2rl.worlds import World

_STEPS = 5  # number of physics steps over which the acceleration is averaged


def measure_motors(robot: Robot, simulator: SimulatorType | None = None) -> tuple[float, float]:
    """Measure `Robot.wheel_acceleration` and `Robot.wheel_coupling` [m/s^2] in a simulator, or in `default_physics`."""
    simulator = simulator or default_physics()
    # The left wheel stands still.
    acceleration = _right_rim_acceleration(robot, simulator, 1.0, 2.0 / robot.wheel_separation)
    return acceleration, _right_rim_acceleration(robot, simulator, 2.0, 0.0) - acceleration


def _right_rim_acceleration(robot: Robot, simulator: SimulatorType, v: float, w: float) -> float:
    """Acceleration of the right wheel's rim [m/s^2] towards a command v [m/s], w [rad/s] on an open floor."""
    floor = World.from_shapes("floor", start=(0.0, 0.0, 0.0), bounds=(-10.0, -10.0, 10.0, 10.0))
    spec = SimulationSpec(robot, replace(robot.laser, beams=1, indices=None), (floor,))
    initial_state = InitialState.default(spec, 1)
    initial_state.records["max_speed"], initial_state.records["max_turn_rate"] = 100.0, 1000.0
    with closing(simulator.open(spec)) as simulation:
        simulation.reset(initial_state, np.random.default_rng(0))
        twists = [simulation.step(np.array([[v, w]]), 1.0 / PHYSICS_RATE).twist[0] for _ in range(1 + _STEPS)]
    forward, turn = (twists[-1] - twists[0]) * PHYSICS_RATE / _STEPS
    return float(forward + turn * robot.wheel_separation / 2)
