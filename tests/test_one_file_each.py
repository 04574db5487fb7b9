"""Everything that users add is one file: each is trained, resumed, evaluated, filmed and reported."""

from __future__ import annotations

import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

import tb2rl
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.report import main as report
from tb2rl.robots.turtlebot2 import ROBOT as TURTLEBOT2
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.training.training import resume, train_config
from tb2rl.viz.film import FilmOptions, film

FILES = {
    "blocks.py": """
        from tb2rl.worlds import World

        def read(path) -> World:
            boxes = [tuple(map(float, line.split())) for line in path.read_text().splitlines()]
            bounds = (-3.0, -3.0, 3.0, 3.0)
            boxes = [(x, y, 1.0, 1.0, 0.0) for x, y in boxes]
            return World.from_shapes(path.stem, boxes, start=(0, 0, 0), bounds=bounds)
        """,
    "yard.blocks": "2.0 2.0\n-2.0 -2.0\n",
    "cruise.py": """
        from dataclasses import dataclass

        import numpy as np

        from tb2rl.tasks import Outcome, Task, Velocities

        @dataclass(frozen=True)
        class Cruise(Task):
            actions = Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0))

            def outcome(self, before, action, after):
                driven = np.hypot(*(after.pose - before.pose)[:, :2].T)
                return Outcome(10 * driven - 5 * after.bumped, failed={"bump": after.bumped})
        """,
    "compass.py": """
        import math
        from dataclasses import dataclass

        import numpy as np

        from tb2rl.sensors import Sensor
        from tb2rl.tasks.wander import Wander

        class Compass(Sensor):
            name, unit = "compass", "rad"
            low, high = -math.pi, math.pi
            bins = (-1.5, 0.0, 1.5)

            def read(self, robot_state):
                return robot_state.pose[:, 2:]

        class Speeds(Sensor):
            name, unit, shape = "speeds", "m/s", (2,)
            low, high = -1.0, 1.0
            bins = (0.1,)

            def read(self, robot_state):
                return robot_state.twist

        @dataclass(frozen=True)
        class Guided(Wander):
            def sensors(self, spec):
                return (*super().sensors(spec), Compass(), Speeds())
        """,
    "picture.py": """
        from dataclasses import dataclass

        import numpy as np

        from tb2rl.sensors import Sensor
        from tb2rl.tasks.wander import Wander

        class Bars(Sensor):
            name, shape = "bars", (1, 36, 36)

            def read(self, robot_state):
                rows = np.arange(36)[:, None] < 12 * np.minimum(robot_state.ranges, 3.0)[:, None, :]
                return (255 * rows[:, None]).astype(np.uint8)

        @dataclass(frozen=True)
        class Pictured(Wander):
            def sensors(self, spec):
                return (*super().sensors(spec), Bars())
        """,
    "small.py": """
        from dataclasses import replace
        from pathlib import Path

        from tb2rl.robots.turtlebot2 import ROBOT as TURTLEBOT2

        ROBOT = replace(
            TURTLEBOT2, name="small", urdf=Path(__file__).with_name("small.urdf"), wheel_joints=("port", "starboard"),
            radius=0.12, wheel_separation=0.16, max_speed=0.3,
        )
        """,
    "dark.py": """
        from tb2rl.sensors.camera import Camera

        class Dark(Camera):
            def read(self, robot_state):
                return super().read(robot_state) // 2
        """,
    "quantiles.py": """
        from tb2rl import Agent

        AGENT = Agent("sb3_contrib:QRDQN")
        """,
    "straight.py": """
        import torch as th
        from stable_baselines3.common.policies import BasePolicy

        from tb2rl import Agent

        AGENT = Agent(algorithm=None, policy="straight:Straight")

        class Straight(BasePolicy):
            def _predict(self, observation, deterministic=False):
                return th.zeros(len(observation), dtype=th.int64)
        """,
}
SMALLER = {'radius="0.178"': 'radius="0.12"', "0.115 0.035": "0.08 0.035"}  # the base, and the wheels' places
SMALLER |= {'joint name="wheel_left"': 'joint name="port"', 'joint name="wheel_right"': 'joint name="starboard"'}
PPO = {"agent.n_steps": 32, "agent.batch_size": 32, "agent.n_epochs": 1}
OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 1000, "agent.batch_size": 16}
RAW = {"task.observation": "raw"}
IMAGES = ("stable_baselines3:PPO", "maze")
LEARNERS = {  # the new thing, and the agent, task and settings to train it with
    "a world format": ("ppo", "maze", {**PPO, "task.world": "blocks:read:{folder}/yard.blocks"}),
    "continuous actions, ppo": ("ppo", "cruise:Cruise", PPO),
    "continuous actions, sac": ("stable_baselines3:SAC", "cruise:Cruise", {**OFF_POLICY, **RAW}),
    "two sensors": ("ppo", "compass:Guided", PPO),
    "two sensors, in classes": ("qlearn", "compass:Guided", {"task.beams": 3}),
    "an image": ("stable_baselines3:PPO", "picture:Pictured", {**PPO, **RAW}),
    "a camera and more": (*IMAGES, {**PPO, **RAW, "task.observe": ["camera", "laser", "twist", "bumper"]}),
    "a camera with colours": (*IMAGES, {**PPO, **RAW, "task.observe": [{"camera": {"colour": True}}]}),
    "an own camera": (*IMAGES, {**PPO, **RAW, "task.observe": [{"dark:Dark": {"width": 36}}]}),
    "a robot": ("dqn", "maze", {**OFF_POLICY, "task.robot": "small:ROBOT"}),
    "a memory": ("sb3_contrib:RecurrentPPO", "maze", {**PPO, **RAW}),
    "an algorithm of sb3-contrib": ("quantiles:AGENT", "maze", {**OFF_POLICY, **RAW}),
}


@pytest.fixture
def mine(tmp_path, monkeypatch) -> Path:
    """A folder with a user's files, from which Python imports."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(dedent(text).lstrip())
    urdf = TURTLEBOT2.urdf.read_text()
    for theirs, ours in SMALLER.items():
        assert theirs in urdf
        urdf = urdf.replace(theirs, ours)
    (tmp_path / "small.urdf").write_text(urdf)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in FILES:
        sys.modules.pop(Path(name).stem, None)


IN_BULLET = ("a camera with colours", "a robot", "a world format", "continuous actions, sac")  # colours: only there


@pytest.mark.slow
@pytest.mark.parametrize("new", LEARNERS)
def test_a_training_is_resumed_evaluated_filmed_and_reported(new, mine):
    agent, task, settings = LEARNERS[new]
    simulation = "bullet" if new in IN_BULLET else "kinematic"
    settings = {k: v.format(folder=mine) if isinstance(v, str) else v for k, v in settings.items()}
    train = {"simulation": simulation, "n_envs": 2, "total_timesteps": 256, "save_freq": 128, "eval_freq": 128}
    train |= {"eval_episodes": 1, "eval_steps": 20, "episode_steps": 40, "stop_score": None}
    config = resolve(agent, task, settings=settings | {f"train.{key}": value for key, value in train.items()})
    run = train_config(config, mine / "run").run
    assert resume(run.folder, 320).timesteps == 64
    evaluation = evaluate(run.folder, episodes=2, steps=30, workers=1)
    assert [len(episode.path) for episode in evaluation.episodes] == [e.length + 1 for e in evaluation.episodes]
    run.write_evaluation(*evaluation.tree(run.config, "mine"))
    assert tb2rl.make_env(tb2rl.load(run.folder)).task == Run.open(run.folder).config.task
    assert film(run.folder, mine / "film.gif", steps=5).stat().st_size > 1000
    assert film(run.folder, mine / "chase.gif", steps=3, camera="chase").stat().st_size > 1000
    report([str(run.folder)])
    assert (run.folder / "report.html").stat().st_size > 10_000


def test_a_baseline_is_evaluated_and_filmed(mine):
    config = resolve("straight:AGENT", "maze")
    policy = make_baseline(config)
    evaluation = evaluate(policy, config, episodes=2, steps=60, workers=1)
    assert {episode.ended for episode in evaluation.episodes} == {"collision"}
    assert all((episode.actions == 0).all() for episode in evaluation.episodes)
    assert film(policy, mine / "film.gif", config, options=FilmOptions(steps=5)).stat().st_size > 1000


def test_an_own_robot_follows_commands_in_both_simulators(mine):
    ends = {}
    for simulation in ("bullet", "kinematic"):
        env = tb2rl.make_env("cruise:Cruise", "raw", simulation=simulation, robot="small:ROBOT", world="wall")
        env.reset(seed=0, options={"pose": (0.0, -2.0, 0.0)})
        for action in ([1.0, 0.0], [1.0, 1.0], [1.0, -1.0]) * 5:
            _, _, _, _, info = env.step(np.array(action, np.float32))
        ends[simulation] = info["pose"]
        assert 0.5 < info["distance"] <= 0.3 * 3.0 + 0.02  # 15 steps of 0.2 s at 0.3 m/s, its fastest
        env.close()
    np.testing.assert_allclose(ends["bullet"][:2], ends["kinematic"][:2], atol=0.05)
