"""Poses and frames of SDF (http://sdformat.org/tutorials?tut=pose_frame_semantics); poses are matrices (4, 4)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from xml.etree.ElementTree import Element

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.markup import name_of, numbers

IDENTITY = np.eye(4)
_FRAMES = ("frame", "link", "model")  # elements that a pose can be relative to
_DEEPEST = 100  # length of a chain of frames


def matrix(pose: Element | None) -> np.ndarray:
    """Parse a <pose>; None and an empty one are the identity.

    Raises:
        InputError: If it is not six finite numbers (or seven, with a quaternion).
    """
    if pose is None or not (pose.text or "").strip():
        return IDENTITY
    placed = np.eye(4)
    if pose.get("rotation_format") == "quat_xyzw":
        *position, x, y, z, w = numbers(pose, 7)
        placed[:3, :3] = _from_quaternion(x, y, z, w)
    else:
        *position, roll, pitch, yaw = numbers(pose, 6)
        turn = math.radians if pose.get("degrees") in ("1", "true") else float
        placed[:3, :3] = from_angles(turn(roll), turn(pitch), turn(yaw))
    placed[:3, 3] = position
    return placed


def from_angles(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation about the fixed axes x, y and z, in this order, shape (3, 3)."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw))
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


def _from_quaternion(x: float, y: float, z: float, w: float) -> np.ndarray:
    length = math.hypot(x, y, z, w)
    if length == 0:
        raise InputError("<pose> has a quaternion of length 0")
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@dataclass
class Scope:
    """The frames of one model, or of the world itself.

    Attributes:
        element: The <model> or <world>.
        own: Its pose in the world.
        warn: Called with a reason and a name for an unknown frame.
    """

    element: Element
    own: np.ndarray
    warn: Callable[[str, str], None]
    _resolving: set[str] = field(default_factory=set)
    _placed: dict[str, np.ndarray] = field(default_factory=dict)

    def place(self, element: Element, default: np.ndarray | None = None) -> np.ndarray:
        """Pose in the world of an element in the scope.

        Args:
            element: A link, a nested model, a frame, a collision, an <include>.
            default: Pose in the world that its pose is relative to if it names no frame; None: that of the scope.

        Raises:
            InputError: If its pose is invalid, or frames are relative to each other in a circle, or in a long chain.
        """
        pose = element.find("pose")
        named = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        named = named or (element.get("attached_to") or "" if element.tag == "frame" else "")
        around = self.frame(named, name_of(element)) if named else None
        if around is None:
            around = self.own if default is None else default
        return around @ matrix(pose)

    @cached_property
    def _frames(self) -> dict[str, Element]:
        """Frames by name; the first of a name counts."""
        return {child.get("name", ""): child for child in reversed(self.element) if child.tag in _FRAMES}

    def frame(self, name: str, user: str) -> np.ndarray | None:
        """Pose of a frame in the world; None, and a warning that names its user, if it is unknown."""
        if name == "world":
            return IDENTITY
        if name == "__model__":
            return self.own
        if name in self._placed:
            return self._placed[name]
        if name not in self._frames:
            self.warn("frames that poses are relative to, but that are not known", f"{name} (of {user})")
            return None
        if name in self._resolving:
            raise InputError(f"the frame {name} is relative to itself")
        if len(self._resolving) == _DEEPEST:
            raise InputError(f"more than {_DEEPEST} frames are each relative to the next")
        self._resolving.add(name)
        self._placed[name] = self.place(self._frames[name])
        self._resolving.remove(name)
        return self._placed[name]
