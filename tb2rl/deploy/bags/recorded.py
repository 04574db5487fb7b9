"""An environment that records its episodes."""

from __future__ import annotations

from typing import Any, SupportsFloat

from tb2rl.deploy.bags.recorder import Recorder
from tb2rl.envs.turtlebot2_env import TurtleBot2Env


class RecordedEnv(TurtleBot2Env):
    """A `TurtleBot2Env` that writes an episode into the bag of `recorder`; each episode needs a new one."""

    recorder: Recorder | None = None  # None: nothing is recorded

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        result = super().reset(seed=seed, options=options)
        if self.recorder is not None and self.robot_state is not None:
            self.recorder.reset(self.robot_state)
        return result

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        result = super().step(action)
        if self.recorder is not None and self.robot_state is not None:
            command = self.scene.actions.commands(self.scene.actions.checked(action))[0]
            self.recorder.step(command, float(result[1]), self.robot_state)
        return result
