"""Everything that users add is one file: each is trained, resumed, evaluated, filmed and reported."""

import json
from importlib import import_module
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

import tb2rl
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.sim_to_sim import available_physics
from tb2rl.report import main as report
from tb2rl.robots.turtlebot2 import ROBOT as TURTLEBOT2
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run
from tb2rl.training.training import resume, train_config
from tb2rl.viz.film import FilmOptions, film

FILES = {
    "blocks.py": """
        from tb2rl.worlds import World

        def read(path) -> World:
            boxes = [(*map(float, line.split()), 1.0, 1.0, 0.0) for line in path.read_text().splitlines()]
            return World.from_shapes(path.stem, boxes, start=(0, 0, 0), bounds=(-3.0, -3.0, 3.0, 3.0))
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
    "senses.py": """
        import numpy as np

        from tb2rl.sensors import Sensor
        from tb2rl.sensors.camera import Camera

        class Speeds(Sensor):
            name, unit, shape, low, high, bins = "speeds", "m/s", (2,), -1.0, 1.0, (0.1,)

            def read(self, robot_state):
                return robot_state.twist

        class Bars(Sensor):
            name, shape = "bars", (1, 36, 36)

            def read(self, robot_state):
                return np.full((len(robot_state.ranges), 1, 36, 36), 255, np.uint8)

        class Dark(Camera):
            pass
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
    "agents.py": """
        import torch as th
        from stable_baselines3.common.policies import BasePolicy

        from tb2rl import Agent

        class Straight(BasePolicy):
            def _predict(self, observation, deterministic=False):
                return th.zeros(len(observation), dtype=th.int64)

        QUANTILES = Agent("sb3_contrib:QRDQN")
        TO_TARGETS = Agent(algorithm=None, policy="agents:Straight")
        """,
}
SMALLER = {'radius="0.178"': 'radius="0.12"', "0.115 0.035": "0.08 0.035"}  # the base, and the wheels' places
SMALLER |= {'joint name="wheel_left"': 'joint name="port"', 'joint name="wheel_right"': 'joint name="starboard"'}
PPO = {"agent.n_steps": 32, "agent.batch_size": 32, "agent.n_epochs": 1, "task.observation": "raw"}
OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 1000, "agent.batch_size": 16, "task.observation": "raw"}
YARD = {"task.world": "blocks:read:yard.blocks"}
SPEEDS = {"task.beams": 3, "task.observe": ["laser", "senses:Speeds"]}
IMAGES = {"task.observe": ["senses:Bars", "camera", "laser", "senses:Speeds"], "task.beams": 36}
DARK = {"task.observe": [{"senses:Dark": {"width": 36, "height": 36, "colour": True}}]}
LEARNERS = {  # the new thing: agent, task, simulator and settings to train it with
    "a world format and continuous actions": ("stable_baselines3:SAC", "cruise:Cruise", "bullet", OFF_POLICY | YARD),
    "a robot": ("dqn", "maze", "bullet", OFF_POLICY | {"task.robot": "small:ROBOT"}),
    "a sensor in bins": ("qlearn", "maze", "kinematic", SPEEDS),
    "two images and numbers": ("stable_baselines3:PPO", "maze", "kinematic", PPO | IMAGES),
    "a camera with colours": ("stable_baselines3:PPO", "maze", "bullet", PPO | DARK),
    "a memory": ("sb3_contrib:RecurrentPPO", "cruise:Cruise", "kinematic", PPO),
    "an algorithm of sb3-contrib": ("agents:QUANTILES", "maze", "kinematic", OFF_POLICY),
}


@pytest.fixture
def mine(module_folder) -> None:
    """A user's files in the working directory, from which Python imports."""
    for name, text in FILES.items():
        (module_folder / name).write_text(dedent(text).lstrip())
    urdf = TURTLEBOT2.urdf.read_text()
    for theirs, ours in SMALLER.items():
        assert theirs in urdf
        urdf = urdf.replace(theirs, ours)
    (module_folder / "small.urdf").write_text(urdf)


@pytest.mark.slow
@pytest.mark.parametrize("new", LEARNERS)
def test_a_training_is_resumed_evaluated_filmed_and_reported(new, mine):
    agent, task, simulation, settings = LEARNERS[new]
    train = {"simulation": simulation, "n_envs": 2, "total_timesteps": 256, "save_freq": 128, "eval_freq": 128}
    train |= {"eval_episodes": 1, "eval_steps": 20, "episode_steps": 40, "stop_score": None}
    train |= {"eval_simulation": simulation}
    config = resolve(agent, task, settings=settings | {f"train.{key}": value for key, value in train.items()})
    run = train_config(config, Path("run")).run
    assert resume(run.folder, 320).timesteps == 64
    evaluation = evaluate(run.folder, episodes=2, steps=30, workers=1)
    assert [len(episode.path) for episode in evaluation.episodes] == [e.length + 1 for e in evaluation.episodes]
    run.write_evaluation(*evaluation.serialize(run.config, "mine"))
    assert tb2rl.make_env(tb2rl.load(run.folder)).task == Run.open(run.folder).config.task
    for camera in ("above", "chase"):
        options = FilmOptions(steps=3, camera=camera)
        assert film(run.folder, Path(f"{camera}.gif"), options=options).stat().st_size > 1000
    report([str(run.folder)])
    assert (run.folder / "report.html").stat().st_size > 10_000


def test_an_own_robot_follows_commands_in_every_simulator(mine):
    ends, physics = {}, [simulator.name for simulator in available_physics("the test")]
    for simulation in (*physics, "kinematic"):
        env = tb2rl.make_env("cruise:Cruise", "raw", simulation=simulation, robot="small:ROBOT", world="wall")
        env.reset(seed=0, options={"pose": (0.0, -2.0, 0.0)})
        for action in ([1.0, 0.0], [1.0, 1.0], [1.0, -1.0]) * 5:
            _, _, _, _, info = env.step(np.array(action, np.float32))
        ends[simulation] = info["pose"]
        assert 0.5 < info["distance"] <= 0.3 * 3.0 + 0.02  # 15 steps of 0.2 s at 0.3 m/s, its fastest
        env.close()
    for name in physics:
        np.testing.assert_allclose(ends[name][:2], ends["kinematic"][:2], atol=0.05)


def test_a_baseline_is_evaluated_and_filmed(mine, capsys):
    policy = ["--agent", "agents:TO_TARGETS", "--episodes", "2", "--steps", "60"]
    import_module("tb2rl.evaluate").main([*policy, "--workers", "1", "--json", "it.json"])
    assert {episode["ended"] for episode in json.loads(Path("it.json").read_text())["each"]} == {"collision"}
    import_module("tb2rl.play").main([*policy, "--video", "film.gif"])
    assert capsys.readouterr().out.count("collision after") == 2
