"""Driving by keys: the command that they change, and what the robot reads as lines of text."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.envs.encodings import ranges_to_bins
from tb2rl.envs.scene import Scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.robots import Laser, Robot
from tb2rl.simulation import RobotState, default_simulator

STILL = np.zeros(2)  # a command: v [m/s], w [rad/s]
STEERING = {"w": (0.1, 0.0), "s": (-0.1, 0.0), "a": (0.0, 0.5), "d": (0.0, -0.5)}  # what a key adds to the command
_BAR_RANGE, _BAR_SCALE = 5.0, 8  # [m] at which a range's bar ends, [characters/m]


class Teleop:
    """The robot in the user's hands: a command that keys change, and what the robot reads and the task says.

    Args:
        scene: What to drive, where, and at which task.
        seed: Of the start poses.
        simulation: "bullet" or "kinematic"; None: see `default_simulator`.
    """

    def __init__(self, scene: Scene, seed: int, simulation: str | None = None) -> None:
        self.scene, self.env = scene, TurtleBot2Env(scene, simulation=simulation or default_simulator())
        self.command = STILL
        self.news = ""
        self.env.reset(seed=seed)
        self.robot_state = self._advance()

    def step(self) -> None:
        """Drive for a control period; an ending starts again elsewhere."""
        before, actions = self.robot_state, self.scene.actions
        self.robot_state = self._advance()
        action = actions.nearest(self.command)
        outcome = self.scene.task.outcome(before, actions.checked(action), self.robot_state)
        ending = outcome.ending(0, timed_out=False)
        if ending:
            self.news = f"{ending.name.upper()} ({self._how_it_was()}): a new start"
            self.command = STILL
            self.env.reset()
            self.robot_state = self._advance()
        elif self.command.any():
            self.news = f"as action {actions.describe(action)}: reward {outcome.reward[0]:+g}"

    @property
    def dynamic_obstacles(self) -> np.ndarray | None:
        """Outlines of what moves, see `RobotState.dynamic_obstacles`, shape (movers, 6); None: nothing does."""
        return None if self.robot_state.dynamic_obstacles is None else self.robot_state.dynamic_obstacles[0]

    def lines(self, height: int) -> list[str]:
        """What the terminal shows on at most so many lines."""
        head = [
            f"{self.scene.place}: arrows or w/a/s/d change the speeds, space stops, q ends",
            *reading_lines(self.robot_state, self.command),
            self.news,
            "",
        ]
        bins = self.scene.task.range_bins if self.scene.observation == "discrete" else None
        rows = max(1, height - len(head))
        return [*head, *range_lines(self.scene.laser, self.robot_state.ranges[0], bins, rows)][:height]

    def steer(self, key: str) -> None:
        """Change the command as a key says."""
        self.command = steered(self.scene.robot, self.command, key)

    def close(self) -> None:
        self.env.close()

    def _advance(self) -> RobotState:
        return self.env.simulation.step(self.command[None], self.scene.task.control_period)

    def _how_it_was(self) -> str:
        touched = (
            "something that moves"
            if self.robot_state.nearest_is_dynamic is not None and self.robot_state.nearest_is_dynamic[0]
            else "a wall"
        )
        return f"touched {touched}" if self.robot_state.bumped[0] else f"nearest {self.robot_state.nearest[0]:.2f} m"


def steered(robot: Robot, command: np.ndarray, key: str) -> np.ndarray:
    """The command (v [m/s], w [rad/s]) that a key makes of another, within what the robot can do, shape (2,)."""
    if key == " ":
        return STILL
    return np.round(robot.within_limits(command + STEERING.get(key, STILL)), 3)


def reading_lines(robot_state: RobotState, command: np.ndarray) -> list[str]:
    """What is commanded, and what the robot does and reads."""
    (x, y, yaw), (v, w) = robot_state.pose[0], robot_state.twist[0]
    bumped = "   BUMPED" if robot_state.bumped[0] else ""
    return [
        f"command  v {command[0]:+5.2f} m/s   w {command[1]:+5.2f} rad/s",
        f"robot    v {v:+z5.2f} m/s   w {w:+z5.2f} rad/s",
        f"pose     x {x:+5.2f} m     y {y:+5.2f} m       yaw {math.degrees(yaw):+.0f} deg",
        f"nearest  {robot_state.nearest[0]:.2f} m{bumped}",
    ]


def range_lines(laser: Laser, ranges: np.ndarray, bins: Sequence[float] | None, rows: int) -> list[str]:
    """A bar for each beam, right to left, or for as many as there are rows.

    Args:
        laser: Whose beams.
        ranges: Shape (beams,) [m].
        bins: Borders of the distance classes [m]; None: the classes are not shown.
        rows: How many lines at most.
    """
    shown = np.unique(np.linspace(0, len(ranges) - 1, min(rows, len(ranges))).round().astype(int))
    classes = None if bins is None else ranges_to_bins(ranges, bins)
    return [
        f"{math.degrees(laser.angles[i]):+4.0f} deg {ranges[i]:6.2f} m "
        f"{'' if classes is None else f'class {classes[i]} '}{'#' * round(min(ranges[i], _BAR_RANGE) * _BAR_SCALE)}"
        for i in shown
    ]
