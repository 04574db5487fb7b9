"""The robot data that a classical navigator needs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Vehicle:
    """A robot and its actions, for policies whose constructor has an argument `vehicle`; by default a TurtleBot2.

    Attributes:
        radius: Radius of the robot's base [m].
        max_speed: Speed at action 1, or of the fastest named action [m/s].
        turn_rate: Turn rate at action 1; with named actions the robot's limit [rad/s].
        period: Control period [s].
        directions: Directions of the laser's beams, right to left [rad]; None: evenly from -90 to 90 degrees.
    """

    radius: float = 0.178
    max_speed: float = 0.65
    turn_rate: float = 2.0
    period: float = 0.1
    directions: tuple[float, ...] | None = None
