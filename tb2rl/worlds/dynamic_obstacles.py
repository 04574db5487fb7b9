"""What moves in a world, as its file or a task's setting says it: how many of what kind, and where they go."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from annotated_types import Ge, Le, Len

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.values import ASCENDING, PAIR, Point, build

MOST = 50  # in one world: each is held against each other, and against every beam
_Number = Annotated[int, Ge(0), Le(MOST)]
_Speed = Annotated[float, Ge(0.001), Le(5)]
_Length = Annotated[float, Ge(0.001), Le(10)]
Share = Annotated[float, Ge(0), Le(1)]
_Coordinate = Annotated[float, Ge(-1e6), Le(1e6)]
Speeds = Annotated[tuple[_Speed, _Speed], PAIR, ASCENDING]
Path = Annotated[tuple[tuple[_Coordinate, _Coordinate], ...], Len(2, 1000)]


@dataclass(frozen=True)
class DynamicObstacles:
    """Some things that move in the same way, such as four people: `{people: 4}`.

    People are round. They walk to random points, as people do: around walls, each other and what else moves. Posts and
    boxes go straight to random points, or along a path; a box looks where it goes.
    """

    people: _Number = 0
    posts: _Number = 0
    boxes: _Number = 0
    radius: _Length = 0.25  # [m] of people and posts
    size: tuple[_Length, _Length] = (0.5, 0.4)  # [m] of boxes: along their way and across
    # [m/s] each draws its own. People walk at 1.34 on a free pavement (Weidmann 1993), and slower in a room.
    speed: Speeds = (0.5, 1.0)
    path: Path | None = None  # [m] of posts and boxes; None: between random points
    closed: bool = False  # whether the path goes on from its last point to its first; else back the way it came
    avoid_robot: bool = False  # whether people walk around the robot, too, or do not see it
    presence: Share = 1.0  # share of the episodes in which they are there: all of them, or nobody

    @property
    def count(self) -> int:
        """How many there are."""
        return self.people + self.posts + self.boxes

    @property
    def route(self) -> tuple[Point, ...]:
        """The points of its path, the first one again where it ends there; none without a path."""
        path = self.path or ()
        return (*path, *path[:1]) if self.closed else path


def find_dynamic_obstacles(setting: Any, where: str) -> tuple[DynamicObstacles, ...]:
    """What a setting means: a mapping such as {people: 4}, a list of them, or None.

    Args:
        setting: As YAML or keyword arguments bring it; or of `DynamicObstacles`.
        where: What it is, for the message: "task.dynamic_obstacles".

    Raises:
        InputError: If it does not fit.
    """
    if setting is None:
        return ()
    entries = setting if isinstance(setting, list | tuple) else [setting]
    if len(entries) > MOST:
        raise InputError(f"{where}: must be at most {MOST} entries, got {len(entries)}")
    dynamic_obstacles = []
    for entry in entries:
        if not isinstance(entry, Mapping | DynamicObstacles):
            text = f"{where}: must say how many of what, such as {{people: 4}}, or be a list; got {entry!r}"
            raise InputError(one_line(text))
        dynamic_obstacles.append(
            entry if isinstance(entry, DynamicObstacles) else build(DynamicObstacles, entry, where)
        )
        _check(dynamic_obstacles[-1], where)
    check_number(dynamic_obstacles, where)
    return tuple(dynamic_obstacles)


def among(dynamic_obstacles: Sequence[DynamicObstacles]) -> str:
    """How many of what, in words: "among 8 people and 1 box"; "" if there are none."""
    kinds, counts = {"people": "person", "posts": "post", "boxes": "box"}, Counter[tuple[str, float]]()
    for group in dynamic_obstacles:
        counts.update({(kind, group.presence): getattr(group, kind) for kind in kinds})
    said = [
        f"{count} {kind if count > 1 else kinds[kind]}{f' in {presence:.0%} of the episodes' if presence < 1 else ''}"
        for (kind, presence), count in counts.items()
        if count
    ]
    return f"among {' and '.join(said)}" if said else ""


def check_number(dynamic_obstacles: Sequence[DynamicObstacles], where: str) -> None:
    """Raise an `InputError` if there are more than `MOST`; `where` is what they are of, for the message."""
    count = sum(group.count for group in dynamic_obstacles)
    if count > MOST:
        raise InputError(f"{where}: must be at most {MOST} movers, got {count}")


def said_of(group: DynamicObstacles) -> dict[str, Any]:
    """What `find_dynamic_obstacles` makes such a group of: all that is not as usual."""
    return {key: value for key, value in asdict(group).items() if value != getattr(DynamicObstacles, key)}


def _check(group: DynamicObstacles, where: str) -> None:
    if not group.count:
        raise InputError(f"{where}: must say how many people, posts or boxes there are, such as {{people: 4}}")
    if group.people and group.path is not None:
        raise InputError(f"{where}: people follow no path; posts and boxes do")
    if group.path is not None and len(set(group.path)) < 2:
        raise InputError(f"{where}: a path must have two different points")
    if group.closed and group.path is None:
        raise InputError(f"{where}: closed is of a path, and there is none")
    if group.avoid_robot and not group.people:
        raise InputError(f"{where}: avoid_robot is of people, and there are none")
