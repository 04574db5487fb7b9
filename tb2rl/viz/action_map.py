"""What a policy does where: the kind of action that it takes at places all over a world."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.worlds import World
from tb2rl.worlds.world import box_polygons

HEADINGS = 16
UNMET, OVER = -1, -2  # in place of an action
_PLACES = 900  # on a map, about


@dataclass(frozen=True)
class ActionMap:
    """What a policy does at places all over a world.

    Attributes:
        world: Which one.
        side: Of the square around each place [m].
        places: x, y [m], shape (places, 2).
        actions: The kind of action (an index into `Actions.names`) at each heading and place, shape (headings,
            places); `UNMET` where training never met the state, `OVER` where an episode ends at once.
        known: Share of the states of a table, of those that the other poses lead to, that training met.
    """

    world: World
    side: float
    places: np.ndarray
    actions: np.ndarray
    known: float = 1.0

    @property
    def walls(self) -> list[list[tuple[float, ...]]]:
        """The corners of each box of the world [m]."""
        return [list(box.exterior.coords) for box in box_polygons(self.world.boxes)]


def action_map(policy: BaseAlgorithm, scene: Scene) -> ActionMap | None:
    """What the greedy policy does, at rest, at places all over the free space and at headings all around.

    Of several worlds it is the first, without what moves there.

    All places are seen at once, by the robots of the twin; None where it cannot show what a sensor reads.

    Args:
        policy: What drives.
        scene: What it was trained to do; its laser is taken without noise.
    """
    try:
        scene.check("kinematic")
    except InputError:
        return None
    table: Any = policy.policy
    scene = scene.changed(laser_noise=0.0)
    places, side = _places(scene.world, scene.robot.radius)
    simulation = KinematicSimulator(scene.spec.without_dynamic_obstacles(), len(places))
    actions, states = [], []
    for initial_state in _starts(scene, places):
        robot_state = simulation.reset(initial_state, np.random.default_rng(0))
        observations = scene.observation_pipeline(scene.command_delay()).begin(robot_state)
        taken = np.array(policy.predict(observations, deterministic=True)[0])
        over = scene.task.outcome(robot_state, np.zeros_like(taken), robot_state).terminated
        actions.append(np.where(over, OVER, scene.actions.kinds(taken)))
        if hasattr(table, "visits"):
            states.append(table.states(observations))
    shown, known = np.stack(actions), 1.0
    if states:
        known = _leave_out_unmet(shown, np.stack(states), table)
    return ActionMap(scene.world, side, places, shown, known)


def _starts(scene: Scene, places: np.ndarray) -> Iterator[InitialState]:
    """For each heading the start of a robot at each of the places (places, 2)."""
    for heading in range(HEADINGS):
        initial_state = scene.task.initial_state(
            scene.spec.within(0), GeneratorDraws(np.random.default_rng(0), len(places))
        )
        initial_state.pose[:, :2], initial_state.pose[:, 2] = places, heading * math.tau / HEADINGS
        yield initial_state


def _leave_out_unmet(actions: np.ndarray, states: np.ndarray, table: Any) -> float:
    """Put `UNMET` where training never met the state.

    Args:
        actions: As in `ActionMap`; changed in place.
        states: The row of the table that each belongs to, same shape.
        table: A policy that counts its updates as `visits`, shape (states, actions).

    Returns:
        The share of the states that training met, of those in which an episode goes on.
    """
    met, going_on = table.visits.numpy().any(axis=1), actions != OVER
    actions[going_on & ~met[states]] = UNMET
    return float(met[np.unique(states[going_on])].mean()) if going_on.any() else 0.0


def _places(world: World, clearance: float) -> tuple[np.ndarray, float]:
    """The middles of a grid's squares that lie in the free space, and the side of a square [m]."""
    free = world.free_space(clearance)
    side = math.sqrt(free.area / _PLACES)
    x0, y0, x1, y1 = world.bounds
    x, y = np.meshgrid(np.arange(x0 + side / 2, x1, side), np.arange(y0 + side / 2, y1, side))
    places = np.column_stack([x.ravel(), y.ravel()])
    inside = places[shapely.contains_xy(free, *places.T)]
    if not len(inside):  # narrower than a square
        inside = np.array([free.representative_point().coords[0]])
    return inside, side
