"""The control loop of any number of environments: action, command, filters, simulator, outcome, observation.

Gymnasium's environment, the vector environments, evaluations and films all use this loop.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple, Self

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import Observations, take_rows
from tb2rl.envs.filters import SensedState, intervention
from tb2rl.envs.observation_pipeline import History
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, RobotState, Simulator, find_simulator
from tb2rl.simulation.random_streams import StreamSource
from tb2rl.simulation.simulator import Generators, ResetGenerators
from tb2rl.tasks import Ending


class FinishedEpisodes(NamedTuple):
    """The n episodes that ended in a step, one row for each."""

    indices: np.ndarray  # indices of the environments, ascending, shape (n,)
    observations: Observations  # last observations, shape (n, ...)
    infos: dict[str, np.ndarray]  # arrays of shape (n, ...) by info key, see `TurtleBot2Env`
    returns: np.ndarray  # sums of rewards, shape (n,)
    lengths: np.ndarray  # [control steps], shape (n,)


class Transition(NamedTuple):
    """A step of all environments, without autoreset: finished episodes have their last observation."""

    observations: Observations
    reward: np.ndarray  # shape (num_envs,), float64
    terminated: np.ndarray  # shape (num_envs,), bool
    truncated: np.ndarray  # shape (num_envs,), bool; only where not terminated
    finished: FinishedEpisodes | None  # None if no episode ended


class ControlLoop:
    """Advances all environments of a simulator in the task of a scene. The environments are independent.

    Args:
        scene: The task, the robot, the worlds and the observation.
        simulator: A simulator that was opened for the scene.

    Attributes:
        distances: Distance driven since the start of each episode [m], shape (num_envs,).
        lengths: Number of control steps since the start of each episode, shape (num_envs,).
        commands: The latest commands after the filters, v [m/s] and w [rad/s], shape (num_envs, 2).
        is_filtered: Whether filters changed the latest command of each environment, shape (num_envs,).
    """

    def __init__(self, scene: Scene, simulator: Simulator) -> None:
        self.scene, self.task, self.simulator, self.num_envs = scene, scene.task, simulator, simulator.num_envs
        self._actions, self._filters = scene.actions, deepcopy(scene.filters)
        self._latency = self.task.resolved_variation.latency[1]  # [control steps] largest command latency
        self._recent_commands, self._observation_pipeline = History(self._latency), scene.observation_pipeline()
        self._recent_readings = History(self.task.resolved_variation.observation_latency[1] if self._filters else 0)
        self._robot_state: RobotState | None = None
        self.is_filtered, self.commands = np.zeros(self.num_envs, dtype=bool), np.zeros((self.num_envs, 2))

    @classmethod
    def open(cls, scene: Scene, simulation: Any, num_envs: int = 1, processes: int | None = None) -> Self:
        """Open a simulator, and make a loop around it.

        Args:
            scene: The task, the robot, the worlds and the observation; the simulator may adapt the scene.
            simulation: Name, type or object of a simulator, see `find_simulator`.
            num_envs: Number of environments.
            processes: Number of processes; None: the simulator's default.

        Raises:
            InputError: If the simulator cannot run here, or lacks the data of a sensor.
        """
        simulator_type = find_simulator(simulation)
        scene = simulator_type.prepare(scene)
        scene.check(simulator_type)
        return cls(scene, simulator_type.open(scene.spec, num_envs, processes))

    @property
    def robot_state(self) -> RobotState:
        """The latest robot state; raises an `InputError` before the first `reset` and after `close`."""
        if self._robot_state is None:
            raise InputError("the environment needs a reset first")
        return self._robot_state

    def reset(self, initial_state: InitialState, rng: Generators) -> Observations:
        """Start an episode in every environment.

        Args:
            initial_state: Initial states, num_envs rows.
            rng: Source of the sensor noise, see `Simulator.reset`.
        """
        self.lengths = np.zeros(self.num_envs, dtype=np.int64)
        self._returns, self.distances = np.zeros(self.num_envs), np.zeros(self.num_envs)
        for command_filter in self._filters:
            command_filter.reset(self.num_envs)
        self._robot_state = reset_state = self.simulator.reset(initial_state, rng)
        self._recent_commands.reset(reset_state.command)
        self._recent_readings.reset(_readings(reset_state))
        return self._observation_pipeline.reset(reset_state)

    def step(self, actions: np.ndarray, inactive: np.ndarray | None = None) -> Transition:
        """Hold an action in each environment for a control period.

        Args:
            actions: Shape (num_envs, ...).
            inactive: Mask of environments whose episode has ended, shape (num_envs,): they get reward 0 and do not end
                again, and their other values are meaningless.
        """
        before = self.robot_state
        commands = self._actions.commands(actions)
        if self._filters:
            commands = self._filter(commands, before)
        self.commands = delayed_commands = commands
        if self._latency:
            delayed_commands = self._recent_commands.delay(commands, before.initial_state.records["command_latency"])
        after = self.simulator.step(delayed_commands, self.task.control_period, inactive)
        # With latency, the policy observes its filtered command; without, the executed one, which a robot may limit.
        observed_commands = commands if self._latency else after.command
        outcome = self.task.outcome(before, actions, after)
        reward, terminated = outcome.reward, outcome.terminated
        if inactive is not None:
            reward, terminated = np.where(inactive, 0.0, reward), terminated & ~inactive
        arguments = reward, self.simulator.travelled, terminated, self.task.episode_steps
        truncated = _count_step(self.lengths, self._returns, self.distances, *arguments)
        if inactive is not None:
            truncated &= ~inactive
        observations, finished = self._observation_pipeline.step(after, observed_commands), None
        self._robot_state, indices = after, (terminated | truncated).nonzero()[0]
        if indices.size:
            last, infos = take_rows(observations, indices), self.infos(indices, outcome.endings(indices))
            finished = FinishedEpisodes(indices, last, infos, self._returns[indices], self.lengths[indices])
        return Transition(observations, reward, terminated, truncated, finished)

    def _filter(self, commands: np.ndarray, robot_state: RobotState) -> np.ndarray:
        """Pass commands (num_envs, 2) through the filters, whose readings are as old as observations."""
        latency = robot_state.initial_state.records["observation_latency"]
        readings = self._recent_readings.delay(_readings(robot_state), latency)
        age = latency * self.task.control_period
        sensed_state = SensedState(**readings, bumped=robot_state.bumped, command=robot_state.command, age=age)
        filtered = commands
        for command_filter in self._filters:
            filtered = command_filter(filtered, sensed_state)
        self.is_filtered = (filtered != commands).any(axis=1)
        return filtered

    def intervention(self, index: int) -> str:
        """Why filters changed the latest command in an environment; empty if they did not, or do not say."""
        return intervention(self._filters, index)

    def reset_at(
        self, indices: np.ndarray, initial_state: InitialState, observations: Observations, rng: ResetGenerators = None
    ) -> None:
        """Start new episodes in some environments.

        Args:
            indices: Indices of these environments, ascending, shape (n,).
            initial_state: Initial states, n rows.
            observations: The latest observations of all environments; the rows `indices` are overwritten.
            rng: n generators of sensor noise. None: each environment keeps its generator.
        """
        before = self.robot_state
        self.lengths[indices], self._returns[indices], self.distances[indices] = 0, 0.0, 0.0
        for command_filter in self._filters:
            command_filter.reset_at(indices)
        self._robot_state, reset_states = self.simulator.reset_at(indices, initial_state, rng)
        self._robot_state.copy_path_lengths(before, indices, reset_states)
        self._recent_commands.reset_at(indices, reset_states.command)
        self._recent_readings.reset_at(indices, _readings(reset_states))
        self._observation_pipeline.reset_at(indices, reset_states, observations)

    def infos(self, indices: slice | np.ndarray = slice(None), endings: Sequence[Ending] = ()) -> dict[str, np.ndarray]:
        """Infos of some environments, by info key, see `TurtleBot2Env`.

        Args:
            indices: Indices of these environments, shape (n,).
            endings: Endings of their n episodes; empty: the episodes continue.
        """
        robot_state = self.robot_state
        infos = {
            "pose": robot_state.pose[indices].copy(),
            "distance": self.distances[indices].copy(),
            "min_range": robot_state.nearest_range[indices].copy(),
            "bumped": robot_state.bumped[indices].copy(),
        }
        if not endings:
            is_success, is_failed = np.zeros((2, len(infos["bumped"])), dtype=bool)
            ending_names = np.full(len(is_success), "", dtype=object)
            return {**infos, "is_success": is_success, "ended": ending_names, "failed": is_failed}
        names, failed, success = zip(*endings, strict=True)
        ending_names = np.array(names, dtype=object)
        return {**infos, "is_success": np.array(success), "ended": ending_names, "failed": np.array(failed)}

    def state(self) -> dict[str, Any]:
        """Everything that future steps of the episodes depend on, as plain values and arrays."""
        return {
            "simulator": self.simulator.state(),
            "robot_state": self.robot_state.state(),
            "observations": self._observation_pipeline.state(),
            "filters": [command_filter.state() for command_filter in self._filters],
            "recent_commands": deepcopy(self._recent_commands.values),
            "recent_readings": deepcopy(self._recent_readings.values),
            "lengths": self.lengths.copy(),
            "returns": self._returns.copy(),
            "distances": self.distances.copy(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a `state`; raises a `ValueError` if its values could crash or hang the simulator."""
        self.simulator.restore(state["simulator"])
        self._robot_state = RobotState.from_state(state["robot_state"], self.simulator)
        self._observation_pipeline.restore(state["observations"])
        for command_filter, filter_state in zip(self._filters, state["filters"], strict=True):
            command_filter.restore(filter_state)
        self._recent_commands.values = deepcopy(state["recent_commands"])
        self._recent_readings.values = deepcopy(state["recent_readings"])
        self.lengths, self._returns = state["lengths"].copy(), state["returns"].copy()
        self.distances = state["distances"].copy()

    def close(self) -> None:
        """Release the resources of the simulator; a reset acquires them again."""
        self.simulator.close()
        self._robot_state = None


def _readings(robot_state: RobotState) -> dict[str, np.ndarray]:
    """The readings of `SensedState` that latency delays, by name."""
    return {"ranges": robot_state.ranges, "pose": robot_state.odometry, "twist": robot_state.odometry_twist}


@njit(cache=True)
def _count_step(lengths, returns, distances, reward, travelled, terminated, episode_steps):
    """Add a step to the sums of each episode, in place; compiled because numpy takes 3 us even for few environments.

    All arrays have the shape (num_envs,). Returns which episodes are truncated after `episode_steps`.
    """
    lengths += 1
    returns += reward
    distances += travelled
    return (lengths >= episode_steps) & ~terminated


class SeededLoop(ControlLoop):
    """A control loop with one random stream per environment.

    The episodes of an environment depend neither on the other environments nor on the number of threads.
    """

    def __init__(self, scene: Scene, simulator: Simulator) -> None:
        super().__init__(scene, simulator)
        self._stream_keys, self._draw_counts = np.zeros((2, self.num_envs), dtype=np.uint64)
        self.seed(None)

    def seed(self, seed: Any) -> None:
        """Seed the random streams of the next `reset_all`; `seed` is a seed for `numpy.random.default_rng`."""
        self._rng = np.random.default_rng(seed)

    def reset_all(self) -> Observations:
        """Start an episode in every environment."""
        key_rng, noise_rng = self._rng.spawn(2)
        self._stream_keys = key_rng.integers(2**64, size=self.num_envs, dtype=np.uint64)
        self._draw_counts = np.zeros(self.num_envs, dtype=np.uint64)
        return self.reset(self._initial_states(np.arange(self.num_envs)), noise_rng)

    def reset_some(self, indices: np.ndarray, observations: Observations) -> None:
        """Start new episodes in some environments, see `reset_at`."""
        self.reset_at(indices, self._initial_states(indices), observations)

    def state(self) -> dict[str, Any]:
        streams = {"keys": self._stream_keys.copy(), "draws": self._draw_counts.copy()}
        return {**super().state(), **streams, "generator": self._rng.bit_generator.state}

    def restore(self, state: Mapping[str, Any]) -> None:
        super().restore(state)
        self._stream_keys, self._draw_counts = state["keys"].copy(), state["draws"].copy()
        self._rng.bit_generator.state = state["generator"]

    def _initial_states(self, indices: np.ndarray) -> InitialState:
        random = StreamSource(self._stream_keys[indices], self._draw_counts[indices])
        initial_state = self.task.randomized_initial_state(self.scene.spec, random)
        self._draw_counts[indices] = random.counts
        return initial_state
