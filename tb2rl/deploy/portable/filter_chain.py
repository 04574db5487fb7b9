"""The filters between a policy and a robot: the safety filter, those of the policy, and the speed limits."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Sequence

import numpy as np

from tb2rl.envs.filters import Filter, SensedState, SpeedLimits, intervention
from tb2rl.envs.safety import Safety

from .policy_contract import Policy, SensorData, Speeds
from .scan_reader import Mounting, Scan, ScanReader, is_full_circle

OFF = "off"  # no safety filter
_MAX_GAP = math.radians(3)  # [rad] between the beams of the safety filter


class FilterChain:
    """Filters the commands for one robot; the speed limits come last. `Driver` explains the arguments.

    Attributes:
        intervention: Why the filters changed the latest command; empty if they did not, or do not say.
        decisions: Number of commands.
        interventions: Number of commands that were changed for such a reason.

    Raises:
        ValueError: If the laser does not suffice for the setting of the safety filter.
    """

    def __init__(self, policy: Policy, limits: SpeedLimits, mounting: Mounting | None, safe: str) -> None:
        filters: list[Filter] = [*getattr(policy, "filters", ()), limits]
        self.intervention, self.decisions, self.interventions = "", 0, 0
        beams = _dense_beams(policy.needs.beams)
        self._safety = _make_safety(policy, safe, beams, filters)
        self._filters = [self._safety, *filters] if self._safety else filters
        self._reader = ScanReader(replace(policy.needs, beams=beams), mounting)

    def reset(self) -> None:
        """Start a new episode."""
        for command_filter in self._filters:
            command_filter.reset(1)

    def __call__(self, speeds: Speeds, sensor_data: SensorData, scan: Scan, age: float) -> tuple[Speeds, str]:
        """Filter a command.

        Args:
            speeds: The command of the policy.
            sensor_data: The latest data; its twist must be that of the robot.
            scan: The latest scan.
            age: Age of the scan [s].

        Returns:
            The filtered command, and the reason for a stop or an empty string.
        """
        values = {name: getattr(sensor_data, name) for name in ("pose", "twist", "bumped", "command")}
        arrays = {name: np.array([value]) for name, value in values.items()}
        sensed_state = SensedState(ranges=sensor_data.ranges[None], age=np.array([max(age, 0.0)]), **arrays)
        dense_ranges, problem = self._reader.read(scan) if self._safety else (sensor_data.ranges, "")
        if problem:
            return speeds, f"for the safety filter, {problem}"
        dense_state, filtered = sensed_state._replace(ranges=dense_ranges[None]), np.array([speeds])
        for command_filter in self._filters:
            filtered = command_filter(filtered, dense_state if command_filter is self._safety else sensed_state)
        self.intervention = intervention(self._filters, 0)
        self.decisions, self.interventions = self.decisions + 1, self.interventions + bool(self.intervention)
        v, w = filtered[0].tolist()
        return (v, w), ""


def _make_safety(policy: Any, setting: str, beams: np.ndarray, filters: Sequence[Filter]) -> Safety | None:
    """The safety filter of a policy; None if it is off, the policy has its own, or the robot is unknown."""
    facts = getattr(policy, "safety", None)
    if setting == OFF or facts is None or any(isinstance(each, Safety) for each in filters):
        return None
    safety, rest = Safety({**facts, "angles": beams}, setting), np.zeros((1, 2))
    safety.reset(1)
    state = SensedState(np.ones((1, len(beams))), np.zeros((1, 3)), rest, np.zeros(1, dtype=bool), rest, np.zeros(1))
    safety(np.ones((1, 2)), state)  # because compilation during the first step would delay a drive
    return safety


def _dense_beams(beams: np.ndarray) -> np.ndarray:
    """Beams [rad] with the field of view of a policy's beams, close enough for the safety filter."""
    if len(beams) > 1 and np.diff(beams).max() <= _MAX_GAP:
        return beams
    if is_full_circle(beams):
        return -math.pi + _MAX_GAP * np.arange(round(math.tau / _MAX_GAP))
    return np.linspace(beams[0], beams[-1], 2 + int((beams[-1] - beams[0]) / _MAX_GAP))
