"""Data of a robot for classical navigators."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Vehicle:
    """Limits of a robot, for the constructor argument `vehicle` of a policy; default: TurtleBot2 in task `navigate`."""

    radius: float = 0.178  # [m] radius of the base
    max_speed: float = 0.65  # [m/s] speed at the continuous action 1, or of the fastest discrete action
    max_turn_rate: float = 2.0  # [rad/s] turn rate at the continuous action 1; with discrete actions, the robot's
    period: float = 0.1  # [s] control period
    directions: tuple[float, ...] | None = None  # [rad] of the beams, right to left; None: evenly over 180 degrees
