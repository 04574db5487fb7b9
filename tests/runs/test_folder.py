"""The run folder: valid at any time, and never overwritten."""

import json
import subprocess
import sys

import numpy as np
import pytest
import yaml

from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run, versions
from tb2rl.runs.loading import load


@pytest.fixture
def run(tmp_path) -> Run:
    """A folder with a config only."""
    return Run.create(tmp_path / "run", resolve("qlearn", settings={"train.seed": 3}))


@pytest.fixture(scope="module")
def algorithm(runs):
    """A trained algorithm."""
    return load(runs / "qlearn")


def files(run: Run) -> set[str]:
    return {str(file.relative_to(run.folder)) for file in run.folder.rglob("*") if file.is_file()}


# ---- the config


def test_a_new_folder_has_its_config_and_the_versions(run):
    assert files(run) == {"config.yaml"}
    tree = yaml.safe_load((run.folder / "config.yaml").read_text())
    assert tree.pop("versions") == versions()
    assert tree == run.config.to_dict()
    assert Run.open(run.folder).config == run.config


def test_an_existing_folder_is_left_alone_unless_it_is_empty(run, refused, tmp_path):
    assert "exists already" in refused(Run.create, run.folder, resolve("dqn"))
    assert Run.open(run.folder).config.agent_name == "qlearn"
    (tmp_path / "file").touch()
    assert "exists already" in refused(Run.create, tmp_path / "file", resolve())
    (tmp_path / "empty").mkdir()
    assert files(Run.create(tmp_path / "empty", resolve())) == {"config.yaml"}


@pytest.mark.parametrize("text", ["agent: [", "agent: {name: qlern}\ntask: {name: maze}"])
def test_a_config_that_does_not_fit_is_refused_with_its_path(text, run, refused):
    (run.folder / "config.yaml").write_text(text)
    assert str(run.folder / "config.yaml") in refused(Run.open, run.folder)


# ---- policies


def test_the_latest_checkpoints_are_kept(algorithm, tmp_path):
    run = Run.create(tmp_path / "run", resolve(settings={"train.keep": 3}))
    for algorithm.num_timesteps in (100, 5, 2000, 30):
        run.save_training(algorithm, {"any": 1})
    assert [file.stem for file in run.checkpoints] == [f"step-{steps:010d}" for steps in (2000, 100, 30)]


def test_only_one_process_trains_in_a_folder(run, refused):
    with run.lock():
        assert "another process is training" in refused(run.lock().__enter__)
    with run.lock():
        pass


@pytest.mark.slow
def test_a_process_that_dies_releases_its_lock(run):
    program = "import os, sys; from pathlib import Path; from tb2rl.runs.folder import Run; "
    program += "run = Run.open(Path(sys.argv[1])); run.lock().__enter__(); os._exit(3)"
    assert subprocess.run([sys.executable, "-c", program, run.folder], check=False).returncode == 3
    with run.lock():
        pass


@pytest.mark.parametrize("end", [b"", b'{"timesteps": 90, "sc', b"\0" * 40], ids=["whole", "torn", "zeros"])
def test_evaluations_while_training_are_appended_and_dropped_whatever_a_crash_left(end, run):
    file = run.folder / "evaluations.jsonl"
    run.drop_training_evaluations(after=100)  # there is no file
    for steps in (50, 150):
        run.append_training_evaluation({"timesteps": steps, "score": 0.5})
    file.write_bytes(file.read_bytes() + end)
    run.drop_training_evaluations(after=100)
    run.append_training_evaluation({"timesteps": 120})
    assert [json.loads(line)["timesteps"] for line in file.read_text().splitlines()] == [50, 120]


def test_evaluations_with_a_damaged_line_are_refused_and_kept(run, refused):
    file = run.folder / "evaluations.jsonl"
    file.write_text(content := '{\n{"timesteps": 50}\n')
    assert f"{file} is damaged" in refused(run.drop_training_evaluations, after=100)
    assert file.read_text() == content


def test_the_standard_evaluation_comes_back(run, refused):
    assert "no policy yet" in refused(run.read_evaluation), "there is nothing to evaluate"
    (run.folder / "final").mkdir()
    (run.folder / "final" / "policy.safetensors").touch()
    assert "python -m tb2rl.evaluate" in refused(run.read_evaluation)
    run.write_evaluation({"success_rate": 0.5, "each": [{"length": 3}]}, {"path": [np.zeros((4, 2)), np.ones((1, 2))]})
    tree, arrays = run.read_evaluation()
    assert tree == {"success_rate": 0.5, "each": [{"length": 3}]}
    assert [path.shape for path in arrays["path"]] == [(4, 2), (1, 2)]


@pytest.mark.parametrize("place", ["final/policy", "best/policy"])
def test_a_new_policy_removes_the_evaluation_of_the_previous_one(place, run, algorithm):
    run.save(algorithm, "final/policy")
    run.write_evaluation({}, {})
    run.save_training(algorithm, {})
    assert run.has_evaluation_episodes, "that checkpoint is not the policy of the run"
    run.save(algorithm, place)
    assert not run.has_evaluation_episodes


def test_a_damaged_evaluation_is_refused(run, refused):
    run.write_evaluation({"a": 1}, {"path": [np.zeros(3)]})
    paths, evaluation = run.folder / "episodes.safetensors", run.folder / "evaluation.json"
    paths.write_bytes(paths.read_bytes()[:-8])
    assert str(paths) in refused(run.read_evaluation)
    for content in ("[1", "3", "[" * 100_000):
        evaluation.write_text(content)
        assert str(evaluation) in refused(run.read_evaluation)
