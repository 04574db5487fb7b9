"""Trackers: what a user's own one is given, and which names are refused."""

import json
import shutil
import sys
from textwrap import dedent

import pytest

from tb2rl.commands.train import train_seeds
from tb2rl.core.errors import InputError, install_extra
from tb2rl.execution.cluster import RayExecutor
from tb2rl.execution.local import LocalExecutor
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load
from tb2rl.train import main
from tb2rl.training.trackers import run_name, runs_folder
from tb2rl.training.training import resume, train_config

MINE = """
    import json

    from tb2rl.core.errors import UnwritableError
    from tb2rl.training.trackers import Tracker

    class Lines(Tracker):
        "A line for each call, beside the run."
        def __init__(self, training):
            super().__init__(training)
            self.write_line(begun=training.name, settings=dict(training.settings), again=self.id)

        def track(self, step, figures, pictures):
            shapes = {key: picture.shape for key, picture in pictures.items()}
            self.write_line(step=step, figures=figures, pictures=shapes)
            self.save_run("mine", step)

        def close(self):
            self.write_line(ended=self.ended)

        def write_line(self, **line):
            with open(f"{self.training.folder}.lines", "a") as file:
                file.write(json.dumps(line) + "\\n")

    class Stops(Lines):
        def track(self, step, figures, pictures):
            super().track(step, figures, pictures)
            if step >= 128:
                raise {"stop": KeyboardInterrupt, "fail": ZeroDivisionError}[self.training.folder.name]

    class Evaluation(Lines):
        "Has the name of another file of a run folder."

    class Full(Lines):
        "Cannot write after the first call, nor be closed."
        def track(self, step, figures, pictures):
            super().track(step, figures, pictures)
            raise UnwritableError("train.track: the disk is full")

        def close(self):
            super().close()
            raise UnwritableError("train.track: the disk is still full")

    class Closed(Lines):
        "Cannot begin."
        def __init__(self, training):
            raise UnwritableError("train.track: there is no disk")

    class Nothing:
        pass
    """
LOGGED = {"eval_freq": 64, "eval_episodes": 2, "eval_steps": 8, "episode_steps": 8}


@pytest.fixture(scope="module", autouse=True)
def my_trackers(tmp_path_factory):
    """The module `my_trackers`."""
    folder = tmp_path_factory.mktemp("modules")
    (folder / "my_trackers.py").write_text(dedent(MINE))
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


def lines(folder) -> list[dict]:
    return [json.loads(line) for line in folder.with_name(f"{folder.name}.lines").read_text().splitlines()]


def test_a_users_own_tracker_gets_what_tensorboard_gets(small, scalars, tmp_path):
    folder = tmp_path / "runs" / "maze" / "qlearn" / "mine"
    run = train_config(small(track=["my_trackers:Lines"], **LOGGED), folder).run
    begun, *calls, last = lines(folder)
    assert (begun["begun"], begun["again"], last) == ("maze/qlearn/mine", None, {"ended": "finished"})
    settings = begun["settings"]
    assert (settings["agent.name"], settings["train.total_timesteps"]) == ("qlearn", 128)
    assert settings["train.track"] == "['my_trackers:Lines']"
    for tag in ("eval/score", "rollout/failure_rate", "rollout/ep_rew_mean"):
        seen = [(call["step"], pytest.approx(call["figures"][tag])) for call in calls if tag in call["figures"]]
        assert scalars(run, tag) == seen != []
    assert not any("time/total_timesteps" in call["figures"] for call in calls)  # the step itself
    pictured = [(call["step"], call["pictures"]["eval/paths"][2]) for call in calls if call["pictures"]]
    assert pictured == [(64, 3), (128, 3)]


def test_a_resumed_training_continues_with_its_trackers_and_tracks_no_step_twice(small, killed, tmp_path):
    config = small(track=["my_trackers:Lines"], save_freq=64, keep=9, **LOGGED | {"eval_freq": 32})
    whole = train_config(config, tmp_path / "whole").run
    folder = killed(whole, tmp_path / "run").folder
    (folder / "tracker-my_trackers.Lines.json").write_text('{"id": "mine", "step": 100}\n')
    resume(folder)
    begun, *calls, last = lines(folder)
    assert (begun["again"], last) == ("mine", {"ended": "finished"})
    all_steps = [call["step"] for call in lines(whole.folder)[1:-1]]
    assert any(64 < step <= 100 for step in all_steps)  # these had arrived before it was killed
    assert [call["step"] for call in calls] == [step for step in all_steps if step > 100] != []


def test_a_training_outlives_a_tracker_that_cannot_write(small, tmp_path, capsys):
    config = small(track=["my_trackers:Full", "my_trackers:Evaluation"], **LOGGED)
    training = train_config(config, tmp_path / "run")
    assert load(training.run.folder / "final" / "policy.safetensors").num_timesteps == training.timesteps == 128
    warnings = capsys.readouterr().err.splitlines()
    assert warnings == ["warning: train.track: the disk is full; the training continues without it"]
    assert lines(tmp_path / "run")[-2:] == [{"ended": "finished"}] * 2  # the other one is closed, too
    assert not training.run.has_evaluation_episodes


def test_a_training_whose_tracker_cannot_begin_leaves_nothing(small, tmp_path):
    with pytest.raises(InputError, match="there is no disk"):
        train_config(small(track=["my_trackers:Closed"]), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_memory_is_named(small, tmp_path):
    folder = train_config(small(track=["my_trackers:Lines"]), tmp_path / "run").run.folder
    (folder / "tracker-my_trackers.Lines.json").write_text("{")
    with pytest.raises(InputError, match=r"tracker-my_trackers\.Lines\.json is damaged"):
        resume(folder, 256)


def test_a_tracker_is_told_how_the_training_ended(small, tmp_path):
    for name, error, ended in (("stop", KeyboardInterrupt, "interrupted"), ("fail", ZeroDivisionError, "failed")):
        with pytest.raises(error):
            train_config(small(track=["my_trackers:Stops"], **LOGGED), tmp_path / name)
        assert lines(tmp_path / name)[-1] == {"ended": ended}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mflow", "unknown tracker in train.track: 'mflow'; did you mean 'mlflow'?"),
        ("my_trackers:Missing", "train.track: cannot import"),
        ("my_trackers:Nothing", "is not a class derived from tb2rl.training.trackers.Tracker"),
    ],
)
def test_other_names_are_refused_before_anything_is_made(name, message, small, tmp_path):
    for train_it in (train_config, lambda config, folder: train_seeds(config, [0], folder, LocalExecutor())):
        with pytest.raises(InputError) as error:
            train_it(small(track=[name]), tmp_path / "run")
        assert message in str(error.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["mlflow", "wandb"])
def test_a_library_that_is_missing_is_named(name, small, tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, f"tb2rl.training.{name}_tracker", raising=False)
    monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    with pytest.raises(InputError) as error:
        train_config(small(track=[name]), tmp_path / "run")
    assert str(error.value) == f"train.track: {name} needs the package {name}: {install_extra(name)}"
    assert list(tmp_path.iterdir()) == []


def test_a_run_folder_imports_no_tracker_that_lies_in_it(small, killed, tmp_path, monkeypatch):
    whole = train_config(small(save_freq=64, keep=9, track=["my_trackers:Lines"]), tmp_path / "whole").run
    folder = killed(whole, tmp_path / "run").folder
    shutil.copy(sys.modules["my_trackers"].__file__, folder / "my_trackers.py")
    monkeypatch.delitem(sys.modules, "my_trackers")
    monkeypatch.syspath_prepend(folder)
    with pytest.raises(InputError, match="nothing is imported from a run folder"):
        resume(folder)
    assert Run.open(folder).config.train.track == ("my_trackers:Lines",)  # to look at it imports nothing


def test_a_cluster_needs_a_server_for_mlflow(small, tmp_path, monkeypatch):
    pytest.importorskip("mlflow", reason="mlflow is not installed")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "sqlite:///mlflow.db")
    with pytest.raises(InputError, match="--on ray, mlflow needs a server for all machines: set MLFLOW_TRACKING_URI"):
        train_seeds(small(track=["mlflow"]), [0], tmp_path / "run", RayExecutor())


@pytest.mark.parametrize("more", ["--no-evaluation", pytest.param("--seeds 0,1", marks=pytest.mark.slow)])
def test_the_command_line_names_trackers(more, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flags = "--simulation kinematic --total-timesteps 64 --n-envs 4 --eval-freq 0 --save-freq 0 --no-progress"
    main([*flags.split(), "--track", "my_trackers:Lines", "--name", "it", *more.split()])
    for name in ("it/seed-0", "it/seed-1") if "--seeds" in more else ("it",):
        begun, *_, last = lines(tmp_path / "runs/maze/qlearn" / name)
        assert (begun["begun"], last) == (f"maze/qlearn/{name}", {"ended": "finished"})


def test_a_run_is_called_by_its_path_in_runs_or_by_what_it_is(small, tmp_path):
    config = small("dqn", "my_tasks:Pictured")
    assert run_name(config.task_name, config.agent_name, tmp_path / "elsewhere") == "Pictured/dqn/elsewhere"
    seed = tmp_path / "runs" / "maze" / "dqn" / "a" / "seed-0"
    assert run_name(config.task_name, config.agent_name, seed) == "maze/dqn/a/seed-0"
    assert runs_folder(tmp_path / "runs" / "maze" / "dqn" / "a") == tmp_path / "runs"
    assert runs_folder(tmp_path / "elsewhere") == tmp_path
