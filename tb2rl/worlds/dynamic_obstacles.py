"""Groups of dynamic obstacles, as a world's file or `task.dynamic_obstacles` describes them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from annotated_types import Ge, Le, Len

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.values import ASCENDING, PAIR, Fraction, Point, build

MOST = 50  # in one world: each is tested against every other one, and against every beam
_Number = Annotated[int, Ge(0), Le(MOST)]
_Speed = Annotated[float, Ge(0.001), Le(5)]
_Length = Annotated[float, Ge(0.001), Le(10)]
_Coordinate = Annotated[float, Ge(-1e6), Le(1e6)]
Speeds = Annotated[tuple[_Speed, _Speed], PAIR, ASCENDING]
Path = Annotated[tuple[tuple[_Coordinate, _Coordinate], ...], Len(2, 1000)]


@dataclass(frozen=True)
class DynamicObstacles:
    """A group of dynamic obstacles that move in the same way, such as four people: `{people: 4}`.

    People are round. They walk to random points around walls, each other and other obstacles. Posts and boxes move
    straight to random points, or along a path; a box faces its direction of motion.
    """

    people: _Number = 0
    posts: _Number = 0
    boxes: _Number = 0
    radius: _Length = 0.25  # [m] of people and posts
    size: tuple[_Length, _Length] = (0.5, 0.4)  # [m] of boxes: along their direction of motion and across
    # [m/s] each draws its own. People walk at 1.34 on a free pavement (Weidmann 1993), and slower in a room.
    speed: Speeds = (0.5, 1.0)
    path: Path | None = None  # [m] of posts and boxes; None: between random points
    closed: bool = False  # from the last point of the path to the first, instead of back and forth
    avoid_robot: bool = False  # people avoid the robot, too
    presence: Fraction = 1.0  # share of the episodes in which the whole group is there

    @property
    def count(self) -> int:
        """Number of obstacles."""
        return self.people + self.posts + self.boxes

    @property
    def route(self) -> tuple[Point, ...]:
        """Points of the path, with the first one again at the end of a closed path; empty without a path."""
        path = self.path or ()
        return (*path, *path[:1]) if self.closed else path

    def settings(self) -> dict[str, Any]:
        """The settings that differ from the defaults, as `find_dynamic_obstacles` takes them."""
        return {key: value for key, value in asdict(self).items() if value != getattr(type(self), key)}


def find_dynamic_obstacles(setting: Any, where: str) -> tuple[DynamicObstacles, ...]:
    """Parse a setting: a mapping such as {people: 4}, a list of mappings or `DynamicObstacles`, or None.

    Args:
        setting: Foreign values.
        where: Name of the setting in messages, such as "task.dynamic_obstacles".

    Raises:
        InputError: If it is invalid.
    """
    if setting is None:
        return ()
    entries = setting if isinstance(setting, list | tuple) else [setting]
    groups = [_group(entry, where) for entry in entries]
    check_number(groups, where)
    return tuple(groups)


def _group(entry: Any, where: str) -> DynamicObstacles:
    if not isinstance(entry, Mapping | DynamicObstacles):
        text = f"{where}: must be a group such as {{people: 4}}, or a list of groups; got {entry!r}"
        raise InputError(one_line(text))
    group = entry if isinstance(entry, DynamicObstacles) else build(DynamicObstacles, entry, where)
    problems = {
        "must say how many people, posts or boxes there are, such as {people: 4}": not group.count,
        "people follow no path; posts and boxes do": group.people and group.path is not None,
        "a path must have two different points": group.path is not None and len(set(group.path)) < 2,
        "closed needs a path, and there is none": group.closed and group.path is None,
        "avoid_robot needs people, and there are none": group.avoid_robot and not group.people,
    }
    for problem, found in problems.items():
        if found:
            raise InputError(f"{where}: {problem}")
    return group


def check_number(groups: Sequence[DynamicObstacles], where: str) -> None:
    """Raise an `InputError` for more than `MOST` obstacles; `where` names the setting in the message."""
    count = sum(group.count for group in groups)
    if count > MOST:
        raise InputError(f"{where}: must be at most {MOST} dynamic obstacles, got {count}")


def among(groups: Sequence[DynamicObstacles]) -> str:
    """Describe groups: "among 8 people and 1 box"; "" without any."""
    kinds, counts = {"people": "person", "posts": "post", "boxes": "box"}, Counter[tuple[str, float]]()
    for group in groups:
        counts.update({(kind, group.presence): getattr(group, kind) for kind in kinds})
    parts = [
        f"{count} {kind if count > 1 else kinds[kind]}{f' in {presence:.0%} of the episodes' if presence < 1 else ''}"
        for (kind, presence), count in counts.items()
        if count
    ]
    return f"among {' and '.join(parts)}" if parts else ""
