"""Wrong input to `train` and `evaluate`: one line on stderr that names the options, exit status 2, no files."""

from __future__ import annotations

import os

import pytest

from tb2rl.__main__ import COMMANDS, main
from tb2rl.commands.benchmark import PARTS
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.evaluation import evaluator
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.episodes import STEPS

FILES = {
    "full.yaml": "boxes: [{centre: [0, 0], size: [4, 4]}]\nstart: [0, 0, 0]\nbounds: [-2, -2, 2, 2]\n",
    "inside.yaml": "boxes: [{centre: [0, 0], size: [1, 1]}]\nstart: [0.3, 0, 0]\nbounds: [-9, -9, 9, 9]\n",
    "narrow.yaml": "cell: 1.0\ndrawing: |\n  #####\n  #.S.#\n  #####\n",
    "typo.yaml": "wals: []\nstart: [0, 0, 0]\n",
    "aimless.yaml": "boxes: [{centre: [5, 5], size: [1, 1]}]\nstart: [0, 0, 0]\nbounds: [-9, -9, 9, 9]\n",
    "nowhere.yaml": "boxes: [{centre: [5, 5], size: [1, 1]}]\n",
}
QUICK = "--n-envs 1 --total-timesteps 1 --eval-freq 0 --no-evaluation"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--agent qlern", ["did you mean 'qlearn'", *agent_names()]),
        ("--task wal", ["did you mean 'wall'", *task_names()]),
        ("--preset tutoral", ["did you mean 'tutorial'"]),
        ("--agent random", ["random does not learn", "tb2rl.evaluate"]),
        ("--simulation gazebo", ["train.simulation", "gazebo", "kinematic"]),
        ("--simulation ros", ["train.simulation", "'ros'", "simulator"]),
        ("--set agent.gamma=high", ["agent.gamma", "number", "'high'"]),
        ("--agent ppo --set agent.batch_size=1", ["batch_size"]),
        ("--set task.observation=raw", ["qlearn", "discrete", "'raw'"]),
        ("--set task.beam_indices=[99]", ["task.beam_indices", "99", "beams"]),
        ("--set 'task.range_bins=[2, 1]'", ["task.range_bins", "increase"]),
        ("--set task.robot=turtelbot2", ["unknown robot", "did you mean 'turtlebot2'"]),
        ("--set task.world=full.yaml", ["world full", "start", "no free space"]),
        ("--set task.world=inside.yaml task.start=fixed", ["world inside", "start (0.3, 0)", "inside"]),
        ("--set task.world=narrow.yaml", ["world narrow", "start", "0.6 m"]),
        ("--set task.world=typo.yaml", ["world typo", "did you mean 'walls'", "boxes"]),
        ("--set task.world=nowhere.yaml", ["world nowhere", "start: [x, y, yaw]"]),
        ("--task wall --set task.world=aimless.yaml", ["world aimless", "goal", "task.goal"]),
        ("--total-timesteps many", ["--total-timesteps", "'many'"]),
        ("--seed 99999999999", ["train.seed", "4294967295"]),
        ("--device gpu", ["cpu", "cuda"]),
        ("--name taken", ["taken", "exists already", "--name"]),
        ("--name ../up", ["--name", "../up"]),
        ("--resume runs/maze/qlearn/none", ["runs/maze/qlearn/none"]),
        ("--on ray", ["--on and --workers go with --seeds"]),
        ("--seeds 0..1 --seed 1", ["--seeds goes neither with"]),
        ("--seeds 0..1", ["--seeds goes neither with", "--no-evaluation"]),
    ],
)
def test_train_refuses_wrong_input(line, named, workdir, refused):
    for name, content in FILES.items():
        (workdir / name).write_text(content)
    (workdir / "runs/maze/qlearn/taken").mkdir(parents=True)
    (workdir / "runs/maze/qlearn/taken/config.yaml").touch()
    refused(main, f"train {'--no-evaluation' if '--resume' in line else QUICK} {line}", named)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["policy", "--agent"]),
        ("RUN --agent random", ["policy", "--agent"]),
        ("RUN --task wall", ["--task"]),
        ("RUN --set agent.gamma=1", ["task.KEY=VALUE", "agent.gamma"]),
        ("RUN --set task.beams=7", ["observation"]),
        ("missing", ["missing", "run folder"]),
        (".", ["not a run folder", "config.yaml"]),
        ("--agent qlearn", ["qlearn", "tb2rl.train"]),
        ("--agent wallfollower --set task.beams=3", ["5 beams", "got 3"]),
        ("--agent wallfollower --set task.observation=discrete", ["wallfollower", "raw"]),
        ("--agent random --episodes 2147483648", ["--episodes", "from 1 to 100000"]),
        ("--agent random --steps 0", ["--steps", "at least 1"]),
        ("--agent random --workers 0", ["--workers", "at least 1"]),
        (f"--agent random --seed {2**64}", ["--seed", "from 0 to 4294967295"]),
        (300 * "x", ["File name too long"]),
        ("--agent random --json missing/it.json", ["missing/it.json"]),
        ("--agent random --simulation gazebo", ["unknown simulator", "bullet, kinematic, ros"]),
    ],
)
def test_evaluate_refuses_wrong_input(line, named, trained_run, refused):
    refused(main, f"evaluate --workers 1 --episodes 1 --steps 1 {line}".replace("RUN", str(trained_run)), named)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--ros 2", ["--ros", "go with --simulation ros"]),
        ("--goal 1,2", ["--goal", "--simulation ros", "task.goal"]),
        ("--simulation ros --workers 2", ["--workers", "one robot"]),
        ("--simulation ros --topics laser=/scan", ["--topics", "laser", "scan"]),
        ("--simulation ros --top-speed 0", ["--top-speed", "greater than 0"]),
        ("--simulation ros --goal 1,nan", ["--goal", "nan"]),
        ("--simulation ros --goal 1,2", ["goal", "navigate"]),
        ("--simulation ros --ros-args -p use_sim_time:=true", ["--ros-args", "--ros 2"]),
    ],
)
def test_evaluate_refuses_contradicting_options_of_a_robot(line, named, refused):
    refused(main, f"evaluate --agent random {line}", named)


@pytest.mark.skipif(os.access("/proc/version", os.W_OK) or os.geteuid() == 0, reason="root can write anywhere")
def test_a_folder_that_cannot_be_written_is_refused(workdir, refused):
    (workdir / "runs").mkdir(mode=0o500)
    refused(main, f"train {QUICK} --name it", ["cannot write", "runs/maze/qlearn/it"])


def test_a_run_folder_below_a_file_is_refused(workdir, refused):
    (workdir / "runs").touch()
    refused(main, f"train {QUICK} --name it", ["runs/maze/qlearn/it"])


SHOWN = {
    "train": [*agent_names(), *task_names()],
    "evaluate": ["zoo:NAME", f"default: {evaluator.EPISODES}", f"default: {evaluator.STEPS}"],
    "play": ["--video", "--teleop", *CAMERAS, f"({STEPS}"],
    "report": ["zoo:NAME", "--out"],
    "benchmark": [*PARTS, "--json"],
    "export": [".onnx", "zoo:NAME"],
    "zoo": ["build", "check", "--again"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_names_the_options(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    out = capsys.readouterr().out
    assert stopped.value.code == 0
    assert f"python -m tb2rl.{name}" in out
    assert [part for part in SHOWN.get(name, []) if part not in out] == []
