"""Measures the acceleration of a robot's wheels in PyBullet, for the kinematic simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tb2rl.robots import Robot
from tb2rl.simulation.bullet.simulator import BulletSimulator
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.spec import PHYSICS_RATE, SimulationSpec
from tb2rl.worlds import World

_STEPS = 5  # physics steps of acceleration


def measure_motors(robot: Robot) -> tuple[float, float]:
    """`Robot.wheel_acceleration` and `Robot.wheel_coupling` [m/s^2], measured on an open floor in PyBullet.

    Args:
        robot: Its present values of these two do not matter.
    """
    alone = _rim_accelerations(robot, 1.0, 2.0 / robot.wheel_separation)[1]  # while the left wheel stands
    together = _rim_accelerations(robot, 2.0, 0.0)[1]
    return alone, together - alone


def _rim_accelerations(robot: Robot, v: float, w: float) -> tuple[float, float]:
    """Of the left and the right wheel's rim [m/s^2] while the motors push towards v [m/s] and w [rad/s]."""
    floor = World.from_shapes("floor", start=(0.0, 0.0, 0.0), bounds=(-10.0, -10.0, 10.0, 10.0))
    spec = SimulationSpec(robot, replace(robot.laser, beams=1, indices=None), (floor,))
    simulation = BulletSimulator(spec)
    initial_state = InitialState.default(spec, 1)
    initial_state.rows["max_speed"], initial_state.rows["max_turn_rate"] = 100.0, 1000.0
    simulation.reset(initial_state, np.random.default_rng(0))
    twists = [simulation.step(np.array([[v, w]]), 1.0 / PHYSICS_RATE).twist[0] for _ in range(1 + _STEPS)]
    simulation.close()
    forward, turn = (twists[-1] - twists[0]) * PHYSICS_RATE / _STEPS
    rim = turn * robot.wheel_separation / 2
    return float(forward - rim), float(forward + rim)
