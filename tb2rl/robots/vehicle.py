"""What a policy that does not learn is told of the robot that it drives."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Vehicle:
    """What drives, and how it is told to; a policy that does not learn is told it if it takes an argument `vehicle`.

    Attributes:
        radius: Of the robot's base [m].
        max_speed: The v that the task's action 1 means [m/s], or that of its fastest named action.
        turn_rate: The w that the task's action 1 means [rad/s]; with named actions the robot's largest.
        period: From one action to the next [s].
        directions: Of the laser's beams, from right to left [rad]; None: evenly from -90 to 90 degrees.
    """

    radius: float = 0.178
    max_speed: float = 0.65
    turn_rate: float = 2.0
    period: float = 0.1
    directions: tuple[float, ...] | None = None
