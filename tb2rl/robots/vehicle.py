"""The robot data that a classical navigator needs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Vehicle:
    """A robot and its actions, for policies whose constructor has an argument `vehicle`; by default a TurtleBot2."""

    radius: float = 0.178  # [m] of the base
    max_speed: float = 0.65  # [m/s] of the action 1, or of the fastest named action
    turn_rate: float = 2.0  # [rad/s] of the action 1; with named actions the robot's limit
    period: float = 0.1  # [s] control period
    directions: tuple[float, ...] | None = None  # [rad] of the beams, right to left; None: evenly over 180 degrees
