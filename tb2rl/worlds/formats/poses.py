"""Poses in SDF: six numbers as a matrix, and what they are relative to (http://sdformat.org/tutorials?tut=pose_frame_semantics)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from xml.etree.ElementTree import Element

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.markup import name_of, numbers

STILL = np.eye(4)
_FRAMES = ("frame", "link", "model")  # what a pose can be relative to
_DEEPEST = 100  # frames that are each relative to the next


def pose_of(element: Element | None) -> np.ndarray:
    """The pose that is an element's <pose>, shape (4, 4); that of the frame it stands in where there is none.

    Raises:
        InputError: If it is not six finite numbers (or seven, with a quaternion).
    """
    pose = None if element is None else element.find("pose")
    return STILL if pose is None else matrix(pose)


def matrix(pose: Element) -> np.ndarray:
    """What the text of a <pose> means, shape (4, 4).

    Raises:
        InputError: If it is not six finite numbers (or seven, with a quaternion).
    """
    if not (pose.text or "").strip():
        return STILL
    placed = np.eye(4)
    if pose.get("rotation_format") == "quat_xyzw":
        *place, x, y, z, w = numbers(pose, 7)
        placed[:3, :3] = _from_quaternion(x, y, z, w)
    else:
        *place, roll, pitch, yaw = numbers(pose, 6)
        turn = math.radians if pose.get("degrees") in ("1", "true") else float
        placed[:3, :3] = _from_angles(turn(roll), turn(pitch), turn(yaw))
    placed[:3, 3] = place
    return placed


def _from_angles(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Turned about the fixed axes x, y and z, in this order."""
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
    """The frames of one model, or of the world itself: what the poses in it can be relative to.

    Attributes:
        element: The <model> or <world>.
        own: Its pose in the world, shape (4, 4).
        warn: What is told, with a name, of a frame that is not known.
    """

    element: Element
    own: np.ndarray
    warn: Callable[[str, str], None]
    _busy: set[str] = field(default_factory=set)
    _placed: dict[str, np.ndarray] = field(default_factory=dict)

    def place(self, element: Element, otherwise: np.ndarray | None = None) -> np.ndarray:
        """The pose in the world of an element within, shape (4, 4).

        Args:
            element: A link, a nested model, a frame, a collision, an <include>.
            otherwise: Where it stands if its pose names no frame, in the world; None: where the scope does.

        Raises:
            InputError: If its pose is no pose, or frames are relative to each other in a circle, or in a long row.
        """
        pose = element.find("pose")
        named = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        named = named or (element.get("attached_to") or "" if element.tag == "frame" else "")
        around = self.frame(named, name_of(element)) if named else None
        if around is None:
            around = self.own if otherwise is None else otherwise
        return around @ pose_of(element)

    @cached_property
    def _frames(self) -> dict[str, Element]:
        """What in it is a frame, by name; the first of a name counts."""
        return {child.get("name", ""): child for child in reversed(self.element) if child.tag in _FRAMES}

    def frame(self, name: str, asking: str) -> np.ndarray | None:
        """The pose of a frame in the world, shape (4, 4); None, and a warning about who asks, if it is not known."""
        if name == "world":
            return STILL
        if name == "__model__":
            return self.own
        if name in self._placed:
            return self._placed[name]
        if name not in self._frames:
            self.warn("frames that poses are relative to, but that are not known", f"{name} (of {asking})")
            return None
        if name in self._busy:
            raise InputError(f"the frame {name} is relative to itself")
        if len(self._busy) == _DEEPEST:
            raise InputError(f"more than {_DEEPEST} frames are each relative to the next")
        self._busy.add(name)
        self._placed[name] = self.place(self._frames[name])
        self._busy.remove(name)
        return self._placed[name]
