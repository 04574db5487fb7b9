"""Full scans from bags, in one table."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.deploy.portable.scan_reader import Scan, measured_distances

_MAX_READINGS = 300_000_000  # 1.2 GB: hours of a drive
_MAX_AGE = 10.0  # [s] a message that seems older has the stamp of another clock, or none


@dataclass(frozen=True)
class Scans:
    """Scans with equal beams, in the order of their stamps."""

    times: np.ndarray  # [s] stamps, in the time of the drive, shape (scans,)
    ages: np.ndarray  # [s] from the stamp to the arrival in the bag, shape (scans,)
    ranges: np.ndarray  # [m] inf without an obstacle in range, NaN if not measured, (scans, beams), right to left
    angles: np.ndarray  # [rad] directions of the beams in the scanner's frame, shape (beams,), ascending


@dataclass
class ScanTable:
    """Collects the scans of a bag."""

    _rows: list[tuple[float, float, Scan]] = field(default_factory=list)
    _readings: int = 0

    def add(self, message: Any, time: float, age: float) -> None:
        """Add a LaserScan that arrived at a time [s] with an age [s]."""
        ranges = np.asarray(message.ranges, dtype=np.float32)
        limits = message.angle_min, message.angle_increment, message.range_min, message.range_max
        self._rows.append((time - age, age, Scan(ranges, *limits)))
        self._readings += len(ranges)
        if self._readings > _MAX_READINGS:
            raise InputError("the bag has more scans than fit into memory: cut it first")

    def scans(self) -> Scans | None:
        """All scans with the most common beams, or None without scans."""
        beams = [(len(scan.ranges), scan.angle_min, scan.angle_increment) for _, _, scan in self._rows]
        if not beams:
            return None
        (count, first, increment), _ = Counter(beams).most_common(1)[0]
        rows = sorted((row for row, each in zip(self._rows, beams, strict=True) if each == (count, first, increment)),
                      key=lambda row: row[0])  # fmt: skip
        angles, step = first + increment * np.arange(count), -1 if increment < 0.0 else 1
        ranges = [measured_distances(scan.ranges[::step], angles[::step], scan) for _, _, scan in rows]
        times, ages, _ = zip(*rows, strict=True)
        return Scans(np.array(times), np.array(ages), np.array(ranges, dtype=np.float32), angles[::step])


def message_age(message: Any, log_time: int) -> float:
    """Time from the stamp of a message to its arrival at `log_time` [ns], in s; 0 if the stamp is of another clock."""
    stamp = message.header.stamp
    age = (log_time - (stamp.sec * 1_000_000_000 + stamp.nanosec)) / 1e9
    return age if abs(age) < _MAX_AGE else 0.0
