"""The command `tb2rl`; wrong input to `train` and `evaluate`: one line on stderr that names the options, status 2."""

from importlib import import_module

import pytest

import tb2rl
from tb2rl.__main__ import COMMANDS, main
from tb2rl.commands.benchmark import PARTS
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.viz.cameras import CAMERAS

QUICK = "--n-envs 1 --total-timesteps 1 --eval-freq 0 --no-evaluation"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--agent qlern", ["did you mean 'qlearn'", *agent_names()]),
        ("--task wal", ["did you mean 'wall'", *task_names()]),
        ("--preset tutoral", ["did you mean 'tutorial'"]),
        ("--agent random", ["random does not learn", "tb2rl.evaluate"]),
        ("--simulation ros", ["train.simulation", "'ros'", "simulator"]),
        ("--set task.observation=raw", ["qlearn", "discrete", "'raw'"]),
        ("--total-timesteps many", ["--total-timesteps", "'many'"]),
        ("--device gpu", ["cpu", "cuda"]),
        ("--name taken", ["taken", "exists already", "--name"]),
        ("--name ../up", ["--name", "../up"]),
        ("--resume runs/maze/qlearn/none", ["runs/maze/qlearn/none"]),
        ("--on ray", ["--on needs --seeds"]),
        ("--seeds 0..1 --seed 1", ["--seed cannot be combined with --seeds"]),
        ("--port 8080", ["--port needs --viewer"]),
    ],
)
def test_train_refuses_wrong_input(line, named, workdir, refused):
    (workdir / "runs/maze/qlearn/taken").mkdir(parents=True)
    (workdir / "runs/maze/qlearn/taken/config.yaml").touch()
    refused(main, f"train {'--no-evaluation' if '--resume' in line else QUICK} {line}", named)


def test_trainings_with_several_seeds_have_no_page(refused):
    refused(main, "train --seeds 0..1 --viewer", ["--viewer cannot be combined with --seeds"])


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["policy", "--agent"]),
        ("RUN --task wall", ["--task needs --agent"]),
        ("RUN --set agent.gamma=1", ["task.KEY=VALUE", "agent.gamma"]),
        ("RUN --set task.beams=7", ["observation"]),
        ("missing", ["missing", "run folder"]),
        ("--agent qlearn", ["qlearn", "tb2rl.train"]),
        ("--agent wallfollower --set task.beams=3", ["5 beams", "got 3"]),
        ("--agent random --episodes 2147483648", ["--episodes", "from 1 to 100000"]),
        (300 * "x", ["xxx"]),
        ("--agent random --json missing/it.json", ["missing/it.json"]),
        ("--agent random --simulation gazebo", ["unknown simulator", "bullet, kinematic, mujoco, ros"]),
        ("--agent random --ros 2", ["--ros needs --simulation ros"]),
        ("--agent random --goal 1,2", ["--goal", "--simulation ros", "task.goal"]),
        ("--agent random --simulation ros --workers 2", ["--workers", "one robot"]),
        ("--agent random --simulation ros --goal 1,nan", ["--goal", "nan"]),
    ],
)
def test_evaluate_refuses_wrong_input(line, named, trained_run, refused):
    refused(main, f"evaluate --episodes 1 --steps 1 {line}".replace("RUN", str(trained_run)), named)


def test_a_run_folder_below_a_file_is_refused(workdir, refused):
    (workdir / "runs").touch()
    refused(main, f"train {QUICK} --name it", ["runs/maze/qlearn/it"])


SHOWN = {"train": [*agent_names(), *task_names()], "play": ["zoo:NAME", *CAMERAS], "benchmark": [*PARTS]}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_names_the_options(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    out = capsys.readouterr().out
    assert stopped.value.code == 0
    assert f"python -m tb2rl.{name}" in out
    assert [part for part in SHOWN.get(name, []) if part not in out] == []


def test_every_command_is_listed_in_a_line(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    main([])
    lines = capsys.readouterr().out.splitlines()
    names = "benchmark calibrate convert demo evaluate export play report ros settings train tune warm worlds zoo"
    assert " ".join(COMMANDS) == names
    for name, module in COMMANDS.items():
        (line,) = [line for line in lines if line.split()[:1] == [name]]
        assert line.endswith(import_module(module).__doc__.splitlines()[0])
        assert len(line) <= 80


def test_the_version_is_printed(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert (stopped.value.code, capsys.readouterr().out) == (0, f"tb2rl {tb2rl.__version__}\n")


def test_an_unknown_command_is_refused(refused):
    message = "error: unknown command 'trian'; did you mean 'train'? known: benchmark, calibrate, convert, demo"
    assert refused(main, "trian").startswith(message)
    assert refused(main, "--agent qlearn").startswith("error: unrecognized arguments: --agent")
