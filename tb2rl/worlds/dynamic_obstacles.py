"""Settings of dynamic obstacles, in world files and in `task.dynamic_obstacles`."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from annotated_types import Ge, Le, Len

from tb2rl.core.errors import InputError
from tb2rl.core.values import ASCENDING, PAIR, Fraction, Point, build

MAX_OBSTACLES = 50  # limit in a world, because each obstacle is tested against all others and all beams
_Count = Annotated[int, Ge(0), Le(MAX_OBSTACLES)]
_Speed = Annotated[float, Ge(0.001), Le(5)]
_Length = Annotated[float, Ge(0.001), Le(10)]
_Coordinate = Annotated[float, Ge(-1e6), Le(1e6)]
_Path = Annotated[tuple[tuple[_Coordinate, _Coordinate], ...], "list of [x, y]", Len(2, 1000)]


@dataclass(frozen=True)
class DynamicObstacles:
    """A group of dynamic obstacles with common settings, such as `{people: 4}`.

    People are round, walk to random points, and avoid walls and other obstacles. Posts and boxes move in straight lines
    to random points or along a path; a box faces its direction of motion.
    """

    people: _Count = 0  # number of people
    posts: _Count = 0  # number of posts
    boxes: _Count = 0  # number of boxes
    radius: _Length = 0.25  # [m] radius of people and posts
    size: tuple[_Length, _Length] = (0.5, 0.4)  # [m] length and width of boxes
    # People walk at 1.34 m/s on a free pavement (Weidmann 1993), and slower in a room.
    speed: Annotated[tuple[_Speed, _Speed], PAIR, ASCENDING] = (0.5, 1.0)  # [m/s] range of random speeds
    path: _Path | None = None  # [m] x, y of the waypoints of posts and boxes; None: random waypoints
    closed: bool = False  # whether the path is a loop; otherwise obstacles move back and forth
    avoid_robot: bool = False  # whether people avoid the robot, too
    presence: Fraction = 1.0  # probability that the group is present in an episode

    @property
    def count(self) -> int:
        return self.people + self.posts + self.boxes

    @property
    def route(self) -> tuple[Point, ...]:
        """Waypoints of the path, none without a path; a closed path ends at its first waypoint."""
        path = self.path or ()
        return (*path, *path[:1]) if self.closed else path

    def settings(self) -> dict[str, Any]:
        """Settings that differ from the defaults, as `parse_dynamic_obstacles` parses them."""
        return {key: value for key, value in asdict(self).items() if value != getattr(type(self), key)}


def parse_dynamic_obstacles(setting: Any, setting_name: str) -> tuple[DynamicObstacles, ...]:
    """Parse a setting: a mapping such as {people: 4}, a `DynamicObstacles`, a list of either, or None.

    Raises:
        InputError: If the setting is invalid. The message contains `setting_name`, such as "task.dynamic_obstacles".
    """
    if setting is None:
        return ()
    groups = []
    for entry in setting if isinstance(setting, list | tuple) else [setting]:
        group = entry if isinstance(entry, DynamicObstacles) else build(DynamicObstacles, entry, setting_name)
        violations = {
            "needs a number of people, posts or boxes, such as {people: 4}": not group.count,
            "people follow no path; posts and boxes do": group.people and group.path is not None,
            "a path must have two different points": group.path is not None and len(set(group.path)) < 2,
            "closed needs a path, and there is none": group.closed and group.path is None,
            "avoid_robot needs people, and there are none": group.avoid_robot and not group.people,
        }
        for rule, is_violated in violations.items():
            if is_violated:
                raise InputError(f"{setting_name}: {rule}")
        groups.append(group)
    check_count(groups, setting_name)
    return tuple(groups)


def check_count(groups: Sequence[DynamicObstacles], setting_name: str) -> None:
    """Raise an `InputError` if groups have more than `MAX_OBSTACLES` obstacles."""
    count = sum(group.count for group in groups)
    if count > MAX_OBSTACLES:
        raise InputError(f"{setting_name}: must be at most {MAX_OBSTACLES} dynamic obstacles, got {count}")


def describe_groups(groups: Sequence[DynamicObstacles]) -> str:
    """Describe groups as "among 8 people and 1 box", or as an empty string without groups."""
    singulars, counts = {"people": "person", "posts": "post", "boxes": "box"}, Counter[tuple[str, float]]()
    for group in groups:
        counts.update({(plural, group.presence): getattr(group, plural) for plural in singulars})
    parts = [
        f"{count} {plural if count > 1 else singulars[plural]}"
        + (f" in {presence:.0%} of the episodes" if presence < 1 else "")
        for (plural, presence), count in counts.items()
        if count
    ]
    return f"among {' and '.join(parts)}" if parts else ""
