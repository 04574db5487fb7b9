"""The runs of a report: the folders of references, names, groups of seeds, and one line for damaged runs."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs.folder import EPISODES, EVALUATION, Run
from tb2rl.runs.loading import load
from tb2rl.viz.run_views import RunView, display_names, group_runs, read_run_view, run_folders

# ---- folders and names


def test_a_folder_of_runs_stands_for_its_runs_and_each_run_counts_once(seeds, goal_run, tmp_path):
    both = [seeds / "seed-0", seeds / "seed-1"]
    assert run_folders([str(seeds)]) == both
    assert run_folders([str(seeds / "seed-1"), str(seeds), str(goal_run)]) == [both[1], both[0], goal_run]
    shutil.copytree(seeds / "seed-0", tmp_path / "parent" / "runs" / "a")
    with pytest.raises(InputError, match=r"neither a run folder nor contains run folders.*; use .*/parent/runs"):
        run_folders([str(tmp_path / "parent")])


def test_names_are_paths_without_their_common_part(seeds, goal_run):
    assert display_names([seeds / "seed-0"]) == ["seed-0"]
    assert display_names([seeds / "seed-0", seeds / "seed-1"]) == ["seed-0", "seed-1"]
    zoo = top_folder("zoo").resolve()
    assert display_names([zoo / "maze-loop-ppo", seeds / "seed-0"]) == ["zoo:maze-loop-ppo", "seed-0"]
    apart = display_names([seeds / "seed-0", goal_run])
    assert [name.split("/")[-2:] for name in apart] == [["seeds", "seed-0"], [goal_run.parent.name, "goal"]]


# ---- groups


def named_views(view: RunView, names: Sequence[str]) -> list[RunView]:
    """Runs of seeds 0, 1, ... in each folder; those of different folders differ in a setting."""
    folders, views = [Path(name).parent for name in names], []
    for i, name in enumerate(names):
        seed, steps = folders[:i].count(folders[i]), 100 + folders.index(folders[i])
        train = replace(view.config.train, seed=seed, eval_steps=steps)
        views.append(replace(view, name=name, config=replace(view.config, train=train)))
    return views


def test_groups_have_names_of_their_own_and_no_training_counts_twice(views):
    apart = group_runs(named_views(views[0], ["ppo/a", "ppo/b", "dqn/a"]))
    assert [group.name for group in apart] == ["ppo", "dqn/a"]
    others = named_views(views[0], ["ppo/a", "ppo/b", "dqn/c", "dqn/d"])
    renamed = [replace(view, name=f"ppo/{view.name[-1]}") for view in others]
    assert [group.name for group in group_runs(renamed)] == ["ppo/a and 1 more", "ppo/c and 1 more"]
    with pytest.raises(InputError, match="first and second are the same training; give only one of them"):
        group_runs([replace(views[0], name="first"), replace(views[0], name="second")])


def test_seeds_are_sorted_and_have_means(views):
    (group,) = group_runs(reversed(views))
    assert group.seeds == [0, 1]
    values = [view.summary["mean_return"] for view in group.views]
    assert group.mean("mean_return") == (sum(values) / 2, bootstrap_interval(values))
    assert (group.settings["train.seed"], group.settings["task.beam_indices"]) == ("0, 1", "none")


# ---- reading


def test_an_evaluation_is_removed_with_the_policy_that_it_is_of(seeds, make, short_evaluations, tmp_path):
    run = Run.open(make.copied(seeds / "seed-0", tmp_path / "run"))
    for place, stays in (("final/policy", True), ("best/policy", False)):
        run.save(load(run.folder), place)
        assert [(run.folder / file).exists() for file in (EVALUATION, EPISODES)] == [stays, stays]
        view = read_run_view(run.folder, "it")
        assert (view.is_stored, len(view.evaluation.episodes)) == (stays, 3 if stays else 1)


@pytest.mark.parametrize("file", ["evaluations.jsonl", "evaluation.json", EPISODES, "best/policy.safetensors"])
def test_damaged_files_are_refused_by_name(file, seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (run / file).write_text("no data\n")
    with pytest.raises(InputError, match=file) as error:
        read_run_view(run, "it")
    assert "\n" not in str(error.value)


def test_a_config_that_the_policy_was_not_trained_with_is_refused(seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run", "task", world="circuit")
    with pytest.raises(InputError, match=r"config\.yaml differs from the config in the policy's checkpoint"):
        read_run_view(run, "it")
