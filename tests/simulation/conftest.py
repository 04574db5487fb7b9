"""Simulators that are closed after a test, and a robot to drive in each physics."""

import math
from contextlib import ExitStack, closing

import numpy as np
import pytest

from tb2rl.core.plugins import robot_names, simulator_names
from tb2rl.robots.robot import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, RobotState, SimulationSpec, find_simulator
from tb2rl.worlds.description import parse_world
from tb2rl.worlds.world import WALL_HEIGHT

SIMULATORS = [name for name in simulator_names() if not find_simulator(name).is_external]
PHYSICS = [name for name in SIMULATORS if find_simulator(name).is_physics]
OPEN = {"boxes": [{"centre": [19, 19], "size": [1, 1]}], "bounds": [-20, -20, 20, 20]}


def _initial_state(spec: SimulationSpec, poses=None, world=0, **fields) -> InitialState:
    """One environment in a world, or one at each of `poses` (num_envs, 3), with some fields of the table set."""
    initial_state = InitialState.default(spec, 1 if poses is None else len(poses), world)
    if poses is not None:
        initial_state.pose[:] = poses
    for name, values in fields.items():
        initial_state.records[name][:] = values
    return initial_state


class Track:
    """One robot in a physics simulator, to be placed and driven."""

    def __init__(self, simulation) -> None:
        self.simulation, self.world, self.robot = simulation, simulation.spec.worlds[0], simulation.spec.robot

    def place(self, x=0.0, y=0.0, yaw=0.0, seed=0) -> RobotState:
        """The first state of an episode at this pose."""
        return self.simulation.reset(_initial_state(self.simulation.spec, [(x, y, yaw)]), np.random.default_rng(seed))

    def drive(self, commands, duration=0.2) -> list[RobotState]:
        """The states after each of `commands` (steps, 2), which lasts `duration` [s]."""
        return [self.simulation.step(np.array([command]), duration) for command in commands]

    def gaps(self, states) -> np.ndarray:
        """Distances between the base and the nearest wall [m], shape (states,)."""
        return np.array([self.world.clearance(*state.pose[0, :2]) for state in states]) - self.robot.radius

    @staticmethod
    def gap(pose, other) -> tuple[float, float]:
        """Distance [m] and angle [rad] between two poses (1, 3)."""
        dx, dy, turn = (pose - other)[0]
        return math.hypot(dx, dy), abs(math.remainder(turn, math.tau))

    @staticmethod
    def record(states) -> np.ndarray:
        """Everything in some states as one array, to compare exactly; NaN where an episode has no goal."""
        return np.array([np.hstack([values[0] for values in state.state().values()]) for state in states])


@pytest.fixture(params=robot_names())
def robot(request):
    """Each registered robot."""
    return find_robot(request.param)


def _available(name: str) -> str:
    if find_simulator(name).unavailable():
        pytest.skip(f"{find_simulator(name).title} {find_simulator(name).unavailable()}")
    return name


@pytest.fixture(params=SIMULATORS)
def simulator(request):
    """The name of each simulator."""
    return _available(request.param)


@pytest.fixture(params=PHYSICS)
def physics(request):
    """The name of each physics simulator."""
    return _available(request.param)


@pytest.fixture
def open_simulator():
    """`find_simulator(name).open(spec, num_envs)`, which is closed after the test."""
    with ExitStack() as stack:
        yield lambda name, *arguments: stack.enter_context(closing(find_simulator(name).open(*arguments)))


@pytest.fixture
def make_physics(physics, open_simulator):
    """A function from a spec to its simulator in each physics, which is closed after the test."""
    return lambda spec: open_simulator(physics, spec)


@pytest.fixture
def make_bullet(open_simulator):
    """A function from a spec to its simulator in PyBullet, which is closed after the test."""
    return lambda spec: open_simulator(_available("bullet"), spec)


@pytest.fixture
def ray_ranges():
    """PyBullet's own ranges [m] of a simulator's world from a pose (3,) along angles (beams,), for the exact laser."""
    pytest.importorskip("pybullet")
    from tb2rl.simulation.bullet.bodies import WALL_GROUP
    from tb2rl.simulation.bullet.client import pybullet

    def cast(simulation, pose, angles) -> np.ndarray:
        (x, y, yaw), length, height = pose, simulation.spec.laser.max_range, WALL_HEIGHT / 2
        ends = [(x + length * math.cos(yaw + a), y + length * math.sin(yaw + a), height) for a in angles]
        only_walls = {"collisionFilterMask": WALL_GROUP, "physicsClientId": simulation._client}
        hits = pybullet.rayTestBatch([(x, y, height)] * len(ends), ends, **only_walls)
        return np.array([hit[2] * length if hit[0] >= 0 else np.inf for hit in hits])

    return cast


@pytest.fixture
def begin():
    """A function that resets a simulator to an `initial_state` with a seed, by default the first world's start."""

    def reset(simulation, initial_state=None, seed=0) -> RobotState:
        default = InitialState.default(simulation.spec, simulation.num_envs)
        return simulation.reset(initial_state or default, np.random.default_rng(seed))

    return reset


@pytest.fixture
def make_track(make_spec, make_physics):
    """A function from a world file's content, the robot, and fields of its laser (else of one beam), to a `Track`."""

    def make(content=OPEN, robot=ROBOT, **laser) -> Track:
        world = parse_world({"start": [-2, 0, 0], "bounds": [-5, -5, 5, 5], **content}, "test")
        return Track(make_physics(make_spec(world, robot=robot, **{"beams": 1, **laser})))

    return make


@pytest.fixture
def start_at():
    """The function `_initial_state`."""
    return _initial_state
