"""An environment that tells a recorder all that happens in it."""

from __future__ import annotations

from typing import Any, SupportsFloat

from tb2rl.deploy.bags.recorder import Recorder
from tb2rl.envs.turtlebot2_env import TurtleBot2Env


class RecordedEnv(TurtleBot2Env):
    """As `TurtleBot2Env`; each episode goes into the bag of `recorder`, which is to be another for each."""

    recorder: Recorder | None = None  # None: nothing is recorded

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        begun = super().reset(seed=seed, options=options)
        if self.recorder is not None and self.robot_state is not None:
            self.recorder.begin(self.robot_state)
        return begun

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        done = super().step(action)
        if self.recorder is not None and self.robot_state is not None:
            command = self.scene.actions.commands(self.scene.actions.checked(action))[0]
            self.recorder.step(command, float(done[1]), self.robot_state)
        return done
