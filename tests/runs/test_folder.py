"""The run folder: valid at every instant, and never overwritten."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.runs.versions import versions


@pytest.fixture
def run(tmp_path) -> Run:
    """A folder with a config alone."""
    return Run.create(tmp_path / "run", resolve("qlearn", settings={"train.seed": 3}))


def files(run: Run) -> set[str]:
    return {str(file.relative_to(run.folder)) for file in run.folder.rglob("*") if file.is_file()}


def test_an_empty_folder_becomes_the_run_folder_where_folders_replace_no_folders_too(tmp_path, monkeypatch):
    replace = Path.replace

    def as_on_windows(self, target):
        if Path(target).is_dir():
            raise PermissionError(13, "Access is denied")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", as_on_windows)
    (tmp_path / "run").mkdir()
    assert files(Run.create(tmp_path / "run", resolve("qlearn"))) == {"config.yaml"}


# ---- the config


def test_a_folder_begins_with_its_config_and_the_versions(run):
    assert files(run) == {"config.yaml"}
    tree = yaml.safe_load((run.folder / "config.yaml").read_text())
    assert tree.pop("versions") == versions()
    assert tree == run.config.to_dict()
    assert Run.open(run.folder).config == run.config
    assert list(run.folder.parent.iterdir()) == [run.folder]


def test_the_version_of_torch_names_its_build_whatever_the_metadata_says(monkeypatch):
    monkeypatch.setattr("torch.__version__", "2.13.0+cu130")
    assert versions()["torch"] == "2.13.0+cu130"


def test_a_folder_that_is_taken_is_left_alone(run, refused, tmp_path):
    assert "exists already" in refused(Run.create, run.folder, resolve("dqn"))
    assert Run.open(run.folder).config.agent_name == "qlearn"
    (tmp_path / "file").touch()
    assert "exists already" in refused(Run.create, tmp_path / "file", resolve())


def test_an_empty_folder_is_taken(tmp_path):
    (tmp_path / "run").mkdir()
    assert Run.create(tmp_path / "run", resolve()).folder == tmp_path / "run"


def test_a_folder_that_cannot_be_made_is_named(refused, tmp_path):
    (tmp_path / "file").touch()
    assert "cannot write the run folder" in refused(Run.create, tmp_path / "file" / "run", resolve())
    assert sorted(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.parametrize("text", ["", "agent: [", "agent: {name: qlearn}", "agent: {name: qlern}\ntask: {name: maze}"])
def test_a_config_that_does_not_fit_is_refused_with_its_path(text, run, refused):
    (run.folder / "config.yaml").write_text(text)
    assert str(run.folder / "config.yaml") in refused(Run.open, run.folder)


# ---- policies


def test_a_policy_is_saved_at_a_place(run, runs):
    algorithm = load(runs / "qlearn")
    file = run.save(algorithm, "final/policy", note="more")
    assert file == run.folder / "final" / "policy.safetensors" == run.policy_file
    assert files(run) == {"config.yaml", "final/policy.safetensors"}


def test_the_last_checkpoints_stay(run, runs):
    algorithm = load(runs / "qlearn")
    for algorithm.num_timesteps in (100, 5, 2000, 30):
        run.save_training(algorithm, {"any": 1})
    assert [file.stem for file in run.checkpoints] == [f"step-{steps:010d}" for steps in (2000, 100, 30, 5)]
    run.prune(2)
    assert [file.stem for file in run.checkpoints] == [f"step-{steps:010d}" for steps in (2000, 100)]


def test_one_process_trains_in_a_folder(run, refused):
    with run.lock():
        assert "another process is training" in refused(run.lock().__enter__)
    with run.lock():
        pass


def test_a_process_that_dies_holds_no_lock(run):
    program = "import os, sys; from pathlib import Path; from tb2rl.runs.folder import Run; "
    program += "run = Run.open(Path(sys.argv[1])); run.lock().__enter__(); os._exit(3)"
    assert subprocess.run([sys.executable, "-c", program, run.folder], check=False).returncode == 3
    with run.lock():
        pass


# ---- evaluations


def test_evaluations_while_training_are_noted_and_forgotten(run):
    run.forget_evaluations(after=100)  # there are none
    for timesteps in (50, 100, 150):
        run.note_evaluation({"timesteps": timesteps, "score": 0.5})
    run.forget_evaluations(after=100)
    lines = (run.folder / "evaluations.jsonl").read_text().splitlines()
    assert [json.loads(line)["timesteps"] for line in lines] == [50, 100]


@pytest.mark.parametrize(
    "end", [b'{"timesteps": 90, "sc', b"\n", b"\0" * 40, b"  \n\n"], ids=["torn", "blank", "zeros", "blanks"]
)
def test_evaluations_whose_last_line_was_not_written_to_its_end_are_forgotten_and_noted_further(end, run):
    file = run.folder / "evaluations.jsonl"
    for timesteps in (50, 150):
        run.note_evaluation({"timesteps": timesteps})
    file.write_bytes(file.read_bytes() + end)
    run.forget_evaluations(after=100)
    run.note_evaluation({"timesteps": 120})
    assert [json.loads(line) for line in file.read_text().splitlines()] == [{"timesteps": 50}, {"timesteps": 120}]


def test_a_last_evaluation_without_a_line_break_stays_apart_from_the_next(run):
    file = run.folder / "evaluations.jsonl"
    file.write_text('{"timesteps": 50}')
    run.forget_evaluations(after=100)
    run.note_evaluation({"timesteps": 120})
    assert [json.loads(line)["timesteps"] for line in file.read_text().splitlines()] == [50, 120]


@pytest.mark.parametrize("line", ["{", "[]", "{}", '{"timesteps": "x"}'])
def test_evaluations_that_are_damaged_elsewhere_are_refused_and_stay(line, run, refused):
    file = run.folder / "evaluations.jsonl"
    file.write_text(content := f'{line}\n{{"timesteps": 50}}\n')
    assert f"{file} is damaged" in refused(run.forget_evaluations, after=100)
    assert file.read_text() == content


def test_an_evaluation_is_on_the_disk_once_it_is_noted(run, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda number: synced.append((run.folder / "evaluations.jsonl").read_text()))
    run.note_evaluation({"timesteps": 50})
    assert synced == ['{"timesteps": 50}\n']


def test_the_standard_evaluation_comes_back(run, refused):
    assert not run.has_evaluation
    assert "no checkpoint yet" in refused(run.read_evaluation), "there is nothing to evaluate"
    (run.folder / "final").mkdir()
    (run.folder / "final" / "policy.safetensors").touch()
    assert "python -m tb2rl.evaluate" in refused(run.read_evaluation)
    run.write_evaluation({"success_rate": 0.5, "each": [{"length": 3}]}, {"path": [np.zeros((4, 2)), np.ones((1, 2))]})
    assert run.has_evaluation
    tree, arrays = run.read_evaluation()
    assert tree == {"success_rate": 0.5, "each": [{"length": 3}]}
    assert [path.shape for path in arrays["path"]] == [(4, 2), (1, 2)]


@pytest.mark.parametrize("place", ["final/policy", "best/policy"])
def test_another_policy_takes_the_evaluation_of_the_last_one_away(place, run, runs):
    algorithm = load(runs / "qlearn")
    run.save(algorithm, "final/policy")
    run.write_evaluation({}, {})
    run.save_training(algorithm, {})
    assert run.has_evaluation, "that checkpoint does not stand for the run"
    run.save(algorithm, place)
    assert not run.has_evaluation


@pytest.mark.parametrize("content", ["", "[1", "[1]", "3", "[" * 100_000, '"x"'], ids=lambda text: text[:5])
def test_an_evaluation_that_is_damaged_is_refused(content, run, refused):
    run.write_evaluation({"a": 1}, {})
    (run.folder / "evaluation.json").write_text(content)
    assert str(run.folder / "evaluation.json") in refused(run.read_evaluation)


def test_paths_that_are_damaged_are_refused(run, refused):
    run.write_evaluation({"a": 1}, {"path": [np.zeros(3)]})
    file = run.folder / "episodes.safetensors"
    file.write_bytes(file.read_bytes()[:-8])
    assert str(file) in refused(run.read_evaluation)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_named(run, refused):
    run.folder.chmod(0o500)
    try:
        assert "cannot write" in refused(run.write_evaluation, {}, {})
    finally:
        run.folder.chmod(0o700)
