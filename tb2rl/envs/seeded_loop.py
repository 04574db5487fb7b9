"""A control loop that draws the initial states of its episodes, for the vector environments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.envs.control_loop import ControlLoop, Transition
from tb2rl.envs.encodings import Observations
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, Simulator
from tb2rl.simulation.random_streams import StreamDraws


class SeededLoop(ControlLoop):
    """Each environment draws from a random stream of its own, so its episodes do not depend on the others or on
    threads.

    Made by `SeededLoop.open`, see `ControlLoop.open`.
    """

    def __init__(self, scene: Scene, simulator: Simulator) -> None:
        super().__init__(scene, simulator)
        self.seed(None)

    def seed(self, seed: Any) -> None:
        """Seed the next reset with anything that `numpy.random.default_rng` takes."""
        self._rng = np.random.default_rng(seed)

    def reset_all(self) -> Observations:
        """Start an episode in every environment."""
        starts, noise = self._rng.spawn(2)
        self._keys = starts.integers(2**64, size=self.num_envs, dtype=np.uint64)
        self._draws = np.zeros(self.num_envs, dtype=np.uint64)
        return self.reset(self._initial_states(np.arange(self.num_envs)), noise)

    def step_and_reset(self, actions: np.ndarray) -> Transition:
        """`step`, after which finished environments are at the start of their next episode."""
        transition = self.step(actions)
        if transition.finished is not None:
            self.reset_some(transition.finished.indices, transition.observations)
        return transition

    def reset_some(self, indices: np.ndarray, observations: Observations) -> None:
        """Start new episodes in some environments, see `reset_at`."""
        self.reset_at(indices, self._initial_states(indices), observations)

    def state(self) -> dict[str, Any]:
        own = {"keys": self._keys.copy(), "draws": self._draws.copy(), "generator": self._rng.bit_generator.state}
        return {**super().state(), **own}

    def restore(self, state: Mapping[str, Any]) -> None:
        super().restore(state)
        self._keys, self._draws = state["keys"].copy(), state["draws"].copy()
        self._rng.bit_generator.state = state["generator"]

    def _initial_states(self, indices: np.ndarray) -> InitialState:
        draws = StreamDraws(self._keys[indices], self._draws[indices])
        initial_state = self.task.randomized_initial_state(self.scene.spec, draws)
        self._draws[indices] = draws.counts
        return initial_state
