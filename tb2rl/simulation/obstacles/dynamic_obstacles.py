"""The things that move beside some robots: each robot has its own, which one number of its start decides about."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.obstacles.motion import (
    AVOIDS,
    CLOSED,
    COUNT,
    FASTEST,
    FIRST,
    KIND,
    MOVER_COLUMNS,
    NEXT,
    NOBODY,
    PATH,
    PERSON,
    SLOWEST,
    SPEED,
    STRAIGHT,
    STRIDE,
)
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, OUTLINE, SIN, WIDTH, X, Y, gap_to, reach_of
from tb2rl.simulation.random_streams import StreamDraws
from tb2rl.simulation.spec import OBSTACLE_SEED, POSE, SimulationSpec
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles as Group
from tb2rl.worlds.geometry import clearance_one

_PLACES = 8  # that are drawn for each mover: it takes the first one that suits
_ROOM = 1.5  # [m] between the robot and a mover where an episode begins, if there is such a place
_KEPT = [LENGTH, WIDTH, *range(KIND, MOVER_COLUMNS)]  # columns that no step changes
_NOTHING = np.eye(MOVER_COLUMNS)[COS]  # the row of a mover that is not there
_NUMBERS = 2.0**53  # that a number in [0, 1) can be


class DynamicObstacles:
    """What moves beside some robots.

    Args:
        spec: The worlds, and what moves in them.
        num_envs: How many.

    Attributes:
        table: All that a moment says of them, shape (num_envs, movers, 24), see `tb2rl.simulation.obstacles.motion`.
        walks: Keys and counts of the random numbers of each robot's movers, shape (num_envs, 2), uint64.
        routes: The points of all paths [m], shape (points, 2).
    """

    def __init__(self, spec: SimulationSpec, num_envs: int) -> None:
        self._spec = spec
        self._kinds, self.routes = _tables(spec)
        self._presence, self._leaders = _presences(spec, self._kinds.shape[1])
        self.table = np.zeros((num_envs, *self._kinds.shape[1:]))
        self.walks = np.zeros((num_envs, 2), dtype=np.uint64)

    @property
    def outlines(self) -> np.ndarray:
        """Where they are, see `RobotState.dynamic_obstacles`: a view of `table`."""
        return self.table[:, :, OUTLINE]

    def begin(
        self, indices: np.ndarray, initial_state: InitialState, index: tuple[np.ndarray, ...], world_of: np.ndarray
    ) -> None:
        """Put the movers of the robots with indices `robots` (n,) where their episodes begin.

        Args:
            indices: Shape (n,).
            start: A row for each of them.
            index: The `Index` of some worlds.
            world_of: The number of each robot's world in it, shape (n,).
        """
        worlds = initial_state.world.astype(int)
        table, keys = self._kinds[worlds], (initial_state.table[:, OBSTACLE_SEED] * _NUMBERS).astype(np.uint64)
        draws = StreamDraws(keys, np.zeros(len(indices), dtype=np.uint64))
        numbers = draws.uniform(table.shape[1] * (_PLACES * 4 + 1)).reshape(len(indices), table.shape[1], -1)
        table[:, :, SPEED] = table[:, :, SLOWEST] + numbers[:, :, -1] * (table[:, :, FASTEST] - table[:, :, SLOWEST])
        places = numbers[:, :, :-1].reshape(len(indices), table.shape[1], _PLACES, 4)
        if (table[:, :, KIND] > PATH).any():
            each = np.repeat(worlds, table.shape[1] * _PLACES)
            found = self._spec.poses_from(each, places.reshape(-1, 4), self._spec.robot.radius)
            places = np.concatenate([found.reshape(*places.shape[:3], 3), places[..., :1]], axis=3)
        else:
            places = places[..., [1, 2, 3, 0]]
        if (self._presence < 1.0).any():
            said = np.take_along_axis(draws.uniform(table.shape[1]), self._leaders[worlds], axis=1)
            table[said >= self._presence[worlds]] = _NOTHING
        _settle(table, self.routes, places, initial_state.table, *index, world_of)
        self.table[indices], self.walks[indices, 0], self.walks[indices, 1] = table, keys, draws.counts

    def state(self) -> dict[str, np.ndarray]:
        """All that their future depends on."""
        return {"table": self.table.copy(), "walks": self.walks.copy()}

    def restore(self, state: Mapping[str, Any], initial_state: InitialState) -> None:
        """Go on from a `state`, where the robots' episodes began with `start`.

        Raises:
            ValueError: If it is not of such movers.
        """
        table, walks = np.array(state["table"], dtype=float), np.array(state["walks"], dtype=np.uint64)
        if table.shape != self.table.shape or walks.shape != self.walks.shape or not np.isfinite(table).all():
            raise ValueError("there are other movers")
        kinds, points = self._kinds[initial_state.world.astype(int)], table[:, :, NEXT]
        away = (table == _NOTHING).all(axis=2) & (self._presence[initial_state.world.astype(int)] < 1.0)
        if not ((table[:, :, _KEPT] == kinds[:, :, _KEPT]).all(axis=2) | away).all():
            raise ValueError("the movers are other ones")
        on_path, speed = table[:, :, KIND] == PATH, table[:, :, SPEED]
        known = (points >= 0) & (points < table[:, :, COUNT]) & (np.abs(table[:, :, STRIDE]) == 1)
        if not ((known | ~on_path).all() and (speed <= kinds[:, :, FASTEST]).all() and (speed >= 0).all()):
            raise ValueError("a mover is on its way to nowhere")
        self.table, self.walks = table, walks


def dynamic_obstacles_of(spec: SimulationSpec, num_envs: int) -> DynamicObstacles | None:
    """The movers of some robots; None where nothing moves."""
    return DynamicObstacles(spec, num_envs) if spec.has_dynamic_obstacles else None


def _tables(spec: SimulationSpec) -> tuple[np.ndarray, np.ndarray]:
    """The movers of each world, (worlds, movers, 24), with what no step changes; and the points of their paths."""
    routes: list[tuple[float, float]] = []
    common = [row for group in spec.dynamic_obstacles for row in _rows(group, routes)]
    rows = [
        [*common, *(row for group in world.dynamic_obstacles for row in _rows(group, routes))] for world in spec.worlds
    ]
    table = np.tile(_NOTHING, (len(rows), max(map(len, rows)), 1))
    for world, own in enumerate(rows):
        table[world, : len(own)] = np.reshape(own, (len(own), MOVER_COLUMNS))
    return table, np.array(routes).reshape(-1, 2)


def _presences(spec: SimulationSpec, dynamic_obstacles: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each mover of each world, (worlds, movers): in what share of episodes it is there, and who decides for it.

    That is the first one of its group, by its number.
    """
    presence, leaders = (
        np.ones((len(spec.worlds), dynamic_obstacles)),
        np.zeros((len(spec.worlds), dynamic_obstacles), dtype=int),
    )
    for number, world in enumerate(spec.worlds):
        first = 0
        for group in (*spec.dynamic_obstacles, *world.dynamic_obstacles):
            own = slice(first, first + group.count)
            presence[number, own], leaders[number, own], first = group.presence, first, own.stop
    return presence, leaders


def _rows(group: Group, routes: list[tuple[float, float]]) -> list[np.ndarray]:
    """A row of the table for each mover of a group; the points of its path are added to `routes`."""
    row = np.zeros(MOVER_COLUMNS)
    row[[COS, STRIDE]] = 1.0
    row[[SLOWEST, FASTEST]] = group.speed
    if group.path is not None:
        row[[FIRST, COUNT, CLOSED]] = len(routes), len(group.path), group.closed
        routes.extend(group.path)
    walk = STRAIGHT if group.path is None else PATH
    shapes = [(PERSON, group.radius, 0.0, float(group.avoid_robot))] * group.people
    shapes += [(walk, group.radius, 0.0, 0.0)] * group.posts
    shapes += [(walk, group.size[0] / 2, group.size[1] / 2, 0.0)] * group.boxes
    rows = np.repeat(row[None], len(shapes), axis=0)
    rows[:, [KIND, LENGTH, WIDTH, AVOIDS]] = shapes
    return list(rows)


@njit(cache=True)
def _settle(dynamic_obstacles, routes, places, starts, boxes, posts, parts, lists, world_of):
    """Put each mover (num_envs, movers, 24) at the first of its places with room, else at that farthest from the robot.

    `places` (num_envs, movers, n, 4) are x, y [m], heading [rad], and a number in [0, 1) that says where on its path it
    is. What is on a path may stand anywhere on it that the robot is not near.
    """
    for i in range(dynamic_obstacles.shape[0]):
        x, y = starts[i, POSE.start], starts[i, POSE.start + 1]
        for k in range(dynamic_obstacles.shape[1]):
            if dynamic_obstacles[i, k, KIND] == NOBODY:
                continue
            farthest, radius = -np.inf, reach_of(dynamic_obstacles, i, k)
            best, point, stride = places[i, k, 0], 0, 1.0
            for n in range(places.shape[2]):
                place = places[i, k, n].copy()
                if dynamic_obstacles[i, k, KIND] == PATH:
                    to, way = _on_path(dynamic_obstacles[i, k], routes, place)
                else:
                    to, way = 0, 1.0
                gap = math.hypot(place[0] - x, place[1] - y) - radius
                suits = gap > _ROOM
                if suits and dynamic_obstacles[i, k, KIND] != PATH:
                    suits = clearance_one(place[0], place[1], boxes, posts, parts, lists, world_of[i]) > radius
                    for other in range(k):
                        if dynamic_obstacles[i, other, KIND] != NOBODY:
                            east, north = (
                                place[0] - dynamic_obstacles[i, other, X],
                                place[1] - dynamic_obstacles[i, other, Y],
                            )
                            suits = suits and gap_to(east, north, dynamic_obstacles, i, other) > radius
                if suits or gap > farthest:
                    farthest, best, point, stride = gap, place, to, way
                if suits:
                    break
            dynamic_obstacles[i, k, X], dynamic_obstacles[i, k, Y] = best[0], best[1]
            dynamic_obstacles[i, k, COS], dynamic_obstacles[i, k, SIN] = math.cos(best[2]), math.sin(best[2])
            dynamic_obstacles[i, k, NEXT], dynamic_obstacles[i, k, STRIDE] = point, stride


@njit(cache=True)
def _on_path(dynamic_obstacle, routes, place):
    """Write into `place` where on its path a mover is, `place[3]` of the whole way; and where it goes next."""
    first, count = int(dynamic_obstacle[FIRST]), int(dynamic_obstacle[COUNT])
    legs = count if dynamic_obstacle[CLOSED] != 0.0 else 2 * count - 2  # there and back
    length = 0.0
    for measuring in (True, False):
        left = place[3] * length
        for leg in range(legs):
            here, there = leg, leg + 1
            if dynamic_obstacle[CLOSED] != 0.0:
                there %= count
            elif leg >= count - 1:
                here, there = 2 * count - 2 - leg, 2 * count - 3 - leg
            ax, ay = routes[first + here]
            bx, by = routes[first + there]
            distance = math.hypot(bx - ax, by - ay)
            if measuring:
                length += distance
            elif left < distance or leg == legs - 1:
                share = left / max(distance, 1e-9)
                place[0], place[1], place[2] = (
                    ax + share * (bx - ax),
                    ay + share * (by - ay),
                    math.atan2(by - ay, bx - ax),
                )
                return there, 1.0 if there >= here or dynamic_obstacle[CLOSED] != 0.0 else -1.0
            else:
                left -= distance
    return 0, 1.0
