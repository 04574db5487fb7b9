"""Poses, frames and saved states of SDF; poses are homogeneous transforms (4, 4).

http://sdformat.org/tutorials?tut=pose_frame_semantics
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from tb2rl.worlds.formats.markup import element_name, element_text, parse_numbers

IDENTITY = np.eye(4)


def parse_pose(pose: Element | None) -> np.ndarray:
    """Parse a <pose>; the result is the identity for None and for an empty element.

    Raises:
        InputError: If the text is not six finite numbers (seven for a quaternion).
    """
    if pose is None or not element_text(pose):
        return IDENTITY
    transform = np.eye(4)
    if pose.get("rotation_format") == "quat_xyzw":
        *position, x, y, z, w = parse_numbers(pose, 7)
        transform[:3, :3] = _from_quaternion(x, y, z, w)
    else:
        *position, roll, pitch, yaw = parse_numbers(pose, 6)
        radians = math.radians if pose.get("degrees") in ("1", "true") else float
        transform[:3, :3] = rotation_from_rpy(radians(roll), radians(pitch), radians(yaw))
    transform[:3, 3] = position
    return transform


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation matrix of roll, pitch and yaw about fixed axes [rad], shape (3, 3)."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw))
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


def _from_quaternion(x: float, y: float, z: float, w: float) -> np.ndarray:
    length = math.hypot(x, y, z, w) or 1.0  # as in Gazebo, a quaternion of length 0 means no rotation
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@dataclass
class Scope:
    """Scope of frame names: a <model> or <world> with its pose in the world, shape (4, 4).

    For an unknown frame, `warn` is called with the reason, and the names of the frame and of the element that uses it.
    """

    element: Element
    pose: np.ndarray
    warn: Callable[[str, str], None]

    def __post_init__(self) -> None:
        self._poses = {"world": IDENTITY, "__model__": self.pose}
        frames = [child for child in self.element if child.tag in ("frame", "link", "model")]
        self._frames = {frame.get("name", ""): frame for frame in reversed(frames)}  # the first of equal names is kept

    def world_pose(self, element: Element, parent: np.ndarray | None = None) -> np.ndarray:
        """Pose of an element in the world; without a frame, its pose is relative to `parent` (None: the scope).

        Raises:
            InputError: If a pose is invalid.
            RecursionError: If frames form a circle or a long chain.
        """
        pose = element.find("pose")
        frame = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        frame = frame or (element.get("attached_to") or "" if element.tag == "frame" else "")
        origin = self.frame_pose(frame, element_name(element)) if frame else None
        if origin is None:
            origin = self.pose if parent is None else parent
        return origin @ parse_pose(pose)

    def frame_pose(self, name: str, user: str) -> np.ndarray | None:
        """Pose of a frame in the world; None with a warning if the frame is unknown.

        `user` is the name of the element that refers to the frame.
        """
        if name not in self._poses:
            if name not in self._frames:
                self.warn("poses refer to unknown frames", f"{name} (of {user})")
                return None
            self._poses[name] = self.world_pose(self._frames[name])
        return self._poses[name]


class State:
    """Saved state of a world, a model or a link.

    Args:
        element: The <state>, or a <model> or <link> in a <state>; None: no saved state.
        scale: Scale of the parent model, shape (3,).

    Attributes:
        pose: Saved pose in the world, also of links and nested models, shape (4, 4); None: no saved pose.
        scale: Scale of the shapes of the model along their axes, shape (3,).
        inserted: Models that were inserted during the simulation.
        deleted: Names of models that were deleted.
        unused: Names of the models and links for which `of` was not called.
    """

    def __init__(self, element: Element | None, scale: np.ndarray) -> None:
        element = Element("state") if element is None else element
        self.inserted = element.findall("insertions/model")
        self.deleted = {element_text(name) for name in element.findall("deletions/name")}
        self.unused = {element_name(part) for part in element if part.tag in ("model", "link")}
        own_scale = element.find("scale")
        self.scale = scale if own_scale is None else np.array(parse_numbers(own_scale, 3, positive=True))
        pose = element.find("pose")
        self.pose = None if pose is None else parse_pose(pose)
        self._parts = {(part.tag, element_name(part)): part for part in element}

    def of(self, part: Element) -> State:
        """State of a model or a link in this model or world."""
        self.unused.discard(element_name(part))
        return State(self._parts.get((part.tag, element_name(part))), self.scale)
