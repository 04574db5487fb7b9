"""Encodings of robot states as observations: classes for tables, numbers and images for networks."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.preprocessing import is_image_space

from tb2rl.core.compiled import njit
from tb2rl.core.errors import InputError
from tb2rl.sensors import Sensor
from tb2rl.sensors.laser import LaserRanges
from tb2rl.simulation import RobotState

BEAMS = {"discrete": 7, "raw": 36}  # default number of laser beams: 30 and 5 degrees apart
NUMBERS = "numbers"  # the key of all numbers in an observation that has images beside them

Observations = Any  # an array (num_envs, ...), or a mapping of names to such arrays


class Encoding(Protocol):
    """Encodes robot states as observations."""

    @property
    def space(self) -> spaces.Space:
        """Space of one environment's observation."""

    def __call__(self, robot_state: RobotState) -> Observations:
        """The observations: an array (num_envs, ...), or a mapping of such arrays."""


class SensorBox(spaces.Box):
    """A box of numbers with units.

    Args:
        sensors: The sensors of the numbers, one after the other.

    Attributes:
        units: Of each number, such as "m" or "rad".
        names: The sensor of each number.
        frame_stack: Number of stacked observations, the oldest first.
    """

    frame_stack = 1

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        low = np.concatenate([np.full(sensor.shape, sensor.low, np.float32) for sensor in sensors])
        high = np.concatenate([np.full(sensor.shape, sensor.high, np.float32) for sensor in sensors])
        super().__init__(low, high, dtype=np.float32)
        self.units = tuple(sensor.unit for sensor in sensors for _ in range(sensor.shape[0]))
        self.names = tuple(sensor.name for sensor in sensors for _ in range(sensor.shape[0]))

    def repeated(self, frame_stack: int) -> SensorBox:
        """The box of several of these observations, one after the other."""
        several = copy(self)
        spaces.Box.__init__(several, np.tile(self.low, frame_stack), np.tile(self.high, frame_stack), dtype=np.float32)
        several.units, several.names = self.units * frame_stack, self.names * frame_stack
        several.frame_stack = frame_stack
        return several


class DiscretizedEncoding:
    """The class of every number, `MultiDiscrete`: for tabular learners."""

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = [(sensor, _increasing(sensor)) for sensor in sensors]
        counts = [len(edges) + 1 for sensor, edges in self._sensors for _ in range(sensor.shape[0])]
        self.space = spaces.MultiDiscrete(counts)

    def __call__(self, robot_state: RobotState) -> np.ndarray:
        classes = [ranges_to_bins(_read(sensor, robot_state), edges) for sensor, edges in self._sensors]
        return classes[0] if len(classes) == 1 else np.column_stack(classes)


class BoxEncoding:
    """Numbers clipped to their limits, float32; a beam that hits nothing becomes the longest range."""

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = sensors
        self._only_laser = len(sensors) == 1 and isinstance(sensors[0], LaserRanges)
        self.space = SensorBox(sensors)

    def __call__(self, robot_state: RobotState) -> np.ndarray:
        values = [_read(sensor, robot_state) for sensor in self._sensors]
        joined = values[0] if len(values) == 1 else np.column_stack(values)
        if not self._only_laser:  # whose ranges are never below its limit
            joined = np.maximum(joined, self.space.low)
        numbers = np.empty(joined.shape, np.float32)
        _clip_above(joined, self.space.high, numbers)
        return numbers


class Image:
    """One uint8 image, for convolutional networks."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self.space = spaces.Box(0, 255, sensor.shape, np.uint8)

    def __call__(self, robot_state: RobotState) -> np.ndarray:
        return np.array(_read(self._sensor, robot_state))  # a copy, because resets overwrite its rows


class DictEncoding:
    """Images by the names of their sensors, and all numbers under "numbers", for networks of several inputs."""

    def __init__(self, numbers: Sequence[Sensor], images: Sequence[Sensor]) -> None:
        self._parts: dict[str, Encoding] = {sensor.name: Image(sensor) for sensor in images}
        if numbers:
            self._parts[NUMBERS] = BoxEncoding(numbers)
        self.space = spaces.Dict({name: part.space for name, part in self._parts.items()})

    def __call__(self, robot_state: RobotState) -> dict[str, np.ndarray]:
        return {name: part(robot_state) for name, part in self._parts.items()}


def encode(mode: str, sensors: Sequence[Sensor]) -> Encoding:
    """The encoding of a mode, "discrete" or "raw", for some sensors.

    Raises:
        InputError: If a sensor cannot be encoded so.
    """
    images = [sensor for sensor in sensors if len(sensor.shape) == 3]
    numbers = [sensor for sensor in sensors if len(sensor.shape) == 1]
    if len(images) + len(numbers) < len(sensors) or not sensors:
        raise InputError("a task needs sensors, each with a shape of (n,), or (channels, height, width) for an image")
    if any(image.shape[0] != min(image.shape) for image in images):
        raise InputError(f"sensor {images[0].name}: the shape of an image is (channels, height, width)")
    if mode == "discrete":
        if images:
            raise InputError(f"sensor {images[0].name} is an image, which has no classes; take observation=raw")
        return DiscretizedEncoding(numbers)
    if not images:
        return BoxEncoding(numbers)
    return Image(images[0]) if len(images) == 1 and not numbers else DictEncoding(numbers, images)


def _read(sensor: Sensor, robot_state: RobotState) -> np.ndarray:
    values = sensor.read(robot_state)
    if values.shape[1:] != sensor.shape or not values.ndim:
        got, fits = values.shape, ("num_envs", *sensor.shape)
        raise InputError(f"sensor {sensor.name} must read an array of shape {fits}, and it has shape {got}")
    return values


def numbers_of(observations: Observations) -> np.ndarray:
    """The numbers or classes in observations, shape (num_envs, n), without images."""
    return observations[NUMBERS] if isinstance(observations, dict) else observations


def rows(observations: Observations, indices: int | np.ndarray) -> Observations:
    """The observation of one environment, or a copy of those of some."""
    if isinstance(observations, dict):
        return {name: values[indices] for name, values in observations.items()}
    return observations[indices]


def put_rows(observations: Observations, indices: np.ndarray, some: Observations) -> None:
    """Overwrite the observations of some environments, in place."""
    if isinstance(observations, dict):
        for name, values in observations.items():
            values[indices] = some[name]
    else:
        observations[indices] = some


def stacked(each: Sequence[Observations]) -> Observations:
    """Stack observations of single environments."""
    if isinstance(each[0], dict):
        return {name: np.stack([one[name] for one in each]) for name in each[0]}
    return np.stack(each)


def has_images(space: spaces.Space) -> bool:
    """Whether there are images among the observations."""
    parts = space.values() if isinstance(space, spaces.Dict) else [space]
    return any(is_image_space(part) for part in parts)


def ranges_to_bins(ranges: np.ndarray, edges: Sequence[float] | np.ndarray) -> np.ndarray:
    """Sort laser ranges, or any other numbers, into classes.

    Args:
        ranges: Distances to the nearest obstacle [m], shape (num_envs, beams); inf where nothing was hit.
        edges: Strictly increasing class borders [m], shape (bins - 1,).

    Returns:
        Class of each beam, shape (num_envs, beams), integers in [0, bins); 0 is nearest, and what NaN becomes.
    """
    bins = np.zeros(np.shape(ranges), dtype=np.int64)
    _count_edges(np.asarray(ranges, dtype=float).ravel(), np.asarray(edges, dtype=float), bins.reshape(-1))
    return bins


@njit(cache=True)
def _clip_above(values, high, numbers):
    """Write the minimum of `values` (num_envs, n) and `high` (n,) to `numbers` (num_envs, n) of another type."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            numbers[i, j] = min(values[i, j], high[j])


@njit(cache=True)
def _count_edges(ranges, edges, bins):
    """Add to each of `bins` (n,) the number of edges that are not above its range in `ranges` (n,)."""
    for i in range(ranges.size):
        for edge in edges:
            bins[i] += ranges[i] >= edge


def _increasing(sensor: Sensor) -> np.ndarray:
    edges = np.asarray(sensor.bins, dtype=float)
    if not len(edges):
        raise InputError(f"sensor {sensor.name} has no bins of classes; set them, or take observation=raw")
    if not (np.diff(edges) > 0).all():
        raise InputError(f"the bins of sensor {sensor.name} must strictly increase, got {list(sensor.bins)}")
    return edges
