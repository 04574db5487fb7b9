"""The runs of a report: the folders of references, names, groups of seeds, and one line for damaged runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs.folder import EVALUATION, PATHS, Run
from tb2rl.runs.loading import load
from tb2rl.viz.run_views import RunView, differences, display_names, group_runs, read_run_view, run_folders


def refused(run) -> str:
    """The one line in which a run is refused."""
    with pytest.raises(InputError) as error:
        read_run_view(run, "it")
    assert "\n" not in str(error.value)
    return str(error.value)


# ---- folders and names


def test_a_folder_of_runs_stands_for_its_runs_and_each_run_counts_once(seeds, goal_run):
    both = [seeds / "seed-0", seeds / "seed-1"]
    assert run_folders([str(seeds)]) == both
    assert run_folders([str(seeds / "seed-1"), str(seeds), str(goal_run)]) == [both[1], both[0], goal_run]


def test_names_are_paths_without_their_common_part(seeds, goal_run, monkeypatch):
    assert display_names([seeds / "seed-0"]) == ["seed-0"]
    assert display_names([seeds / "seed-0", seeds / "seed-1"]) == ["seed-0", "seed-1"]
    zoo = top_folder("zoo").resolve()
    assert display_names([zoo / "maze-loop-ppo", seeds / "seed-0"]) == ["zoo:maze-loop-ppo", "seed-0"]
    apart = display_names([seeds / "seed-0", goal_run])
    assert [name.split("/")[-2:] for name in apart] == [["seeds", "seed-0"], [goal_run.parent.name, "goal"]]

    def two_drives(paths):
        raise ValueError("Paths don't have the same drive")  # as on Windows

    monkeypatch.setattr("os.path.commonpath", two_drives)
    assert display_names([seeds / "seed-0", goal_run]) == [str(seeds / "seed-0"), str(goal_run)]


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("missing", "no run folder missing"),
        (".", r"neither a run folder nor a folder of them: it has no config\.yaml; use Errand/ppo$"),
        ("file", "no run folder file"),
        ("zoo:missing", "unknown zoo policy 'missing'"),
    ],
)
def test_references_without_a_run_are_refused(reference, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "Errand/ppo/today").mkdir(parents=True)
    (tmp_path / "Errand/ppo/today/config.yaml").touch()
    with pytest.raises(InputError, match=message):
        run_folders([reference])


# ---- groups


def named_views(view: RunView, names: Sequence[str]) -> list[RunView]:
    """Runs of seeds 0, 1, ... in each folder; those of different folders differ in a setting."""
    folders = [str(Path(name).parent) for name in names]
    trainings = [
        replace(view.config.train, seed=folders[:i].count(folder), eval_steps=100 + folders.index(folder))
        for i, folder in enumerate(folders)
    ]
    return [
        replace(view, name=name, config=replace(view.config, train=training))
        for name, training in zip(names, trainings, strict=True)
    ]


def test_groups_have_names_and_colours_of_their_own(views):
    apart = group_runs(named_views(views[0], ["ppo/a", "ppo/b", "dqn/a"]))
    assert [group.name for group in apart] == ["ppo", "dqn/a"]
    renamed = [
        replace(v, name=f"ppo/{v.name[-1]}") for v in named_views(views[0], ["ppo/a", "ppo/b", "dqn/c", "dqn/d"])
    ]
    assert [group.name for group in group_runs(renamed)] == ["ppo/a and 1 more", "ppo/c and 1 more"]
    many = group_runs(named_views(views[0], [f"{i}/run" for i in range(9)]))
    assert len({group.colour for group in many}) == 9


def test_seeds_are_sorted_and_have_means(views):
    (group,) = group_runs(reversed(views))
    assert (group.seeds, group.trained_steps) == ([0, 1], [24_000])
    values = [view.summary["mean_return"] for view in group.views]
    assert group.mean("mean_return") == (sum(values) / 2, bootstrap_interval(values))
    assert (group.settings["train.seed"], group.settings["task.beam_indices"]) == ("0, 1", "none")


def test_differences_between_groups_are_named(views):
    first, second = named_views(views[0], ["a/x", "b/x"])
    noisy = replace(second.config, task=replace(second.config.task, laser_noise=0.1))
    groups = group_runs([first, replace(second, config=noisy)])
    assert differences(groups) == {"task.laser_noise": ["0.0", "0.1"], "train.eval_steps": ["100", "101"]}
    assert differences(groups[:1]) == {}


def test_one_training_twice_is_refused(views):
    with pytest.raises(InputError, match="first and second are the same training: name one of them"):
        group_runs([replace(views[0], name="first"), replace(views[0], name="second")])


# ---- reading


def test_a_run_is_read_with_its_evaluation_and_its_curves(views):
    view = views[1]
    assert (view.name, view.is_stored, view.trained_steps) == ("seed-1", True, 24_000)
    assert [episode.ended for episode in view.evaluation.episodes] == ["collision"] * 3
    assert view.summary["failure_free_rate"] == 0.0
    assert view.curves.keys() >= {"rollout/ep_rew_mean", "failure_free_rate"}
    assert "success_rate" not in view.curves, "without a goal it would be the failure-free rate"
    assert view.versions.keys() >= {"tb2rl", "torch"}
    assert view.action_names == ("forward", "left", "right")
    assert view.action_shares.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("place", "stays"), [("final/policy", True), ("best/policy", False)])
def test_an_evaluation_is_removed_with_the_policy_that_it_is_of(place, stays, seeds, make, short_evaluations, tmp_path):
    run = Run.open(make.copied(seeds / "seed-0", tmp_path / "run"))
    assert read_run_view(run.folder, "it").is_stored
    run.save(load(run.folder), place)
    assert [(run.folder / file).exists() for file in (EVALUATION, PATHS)] == [stays, stays]
    view = read_run_view(run.folder, "it")
    assert (view.is_stored, len(view.evaluation.episodes)) == (stays, 3 if stays else 1)


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("evaluations.jsonl", '{"timesteps": 1}\n'),
        ("evaluation.json", "{}"),
        (PATHS, "no arrays"),
        ("config.yaml", "agent: {name: qlern}\ntask: {name: maze}"),
        ("best/policy.safetensors", "no arrays"),
    ],
)
def test_damaged_files_are_refused_by_name(file, content, seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (run / file).write_text(content)
    assert file in refused(run)


def test_a_config_that_the_policy_was_not_trained_with_is_refused(seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run", "task", world="circuit")
    assert "config.yaml is not the config that its policy was trained with" in refused(run)
