"""Runs that differ in nothing but their seed are shown together, under a name and a colour of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tb2rl.core.errors import InputError
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.viz.groups import differences, grouped
from tb2rl.viz.palettes import ACTIONS, GROUPS, colours
from tb2rl.viz.subjects import Subject, read_subject


def subjects_of(seeds: Path, names: Sequence[str]) -> list[Subject]:
    """Runs of seeds 0, 1, ... in each folder; those of different folders differ in their settings."""
    subject, folders = read_subject(seeds / "seed-0", ""), [str(Path(name).parent) for name in names]
    trainings = [
        replace(subject.config.train, seed=folders[:i].count(folder), eval_steps=100 + folders.index(folder))
        for i, folder in enumerate(folders)
    ]
    return [
        replace(subject, name=name, config=replace(subject.config, train=training))
        for name, training in zip(names, trainings, strict=True)
    ]


def test_groups_have_names_of_their_own(seeds):
    apart = grouped(subjects_of(seeds, ["ppo/a", "ppo/b", "dqn/a"]))
    assert [group.name for group in apart] == ["ppo", "dqn/a"]
    subjects = subjects_of(seeds, ["ppo/a", "ppo/b", "dqn/c", "dqn/d"])
    mixed = grouped([replace(subject, name=f"ppo/{subject.name[-1]}") for subject in subjects])
    assert [group.name for group in mixed] == ["ppo/a and 1 more", "ppo/c and 1 more"]


@pytest.mark.parametrize("count", [2, 8, 9, 20])
def test_groups_have_colours_of_their_own(count, seeds):
    groups = grouped(subjects_of(seeds, [f"{i}/run" for i in range(count)]))
    assert len({group.colour for group in groups}) == len(groups) == count


@pytest.mark.parametrize("first", [GROUPS, ACTIONS])
def test_no_two_colours_are_the_same(first):
    for count in (1, len(first), len(first) + 1, 40):
        found = colours(count, first)
        assert len(set(found)) == count
        assert all(len(colour) == 7 and int(colour[1:], 16) >= 0 for colour in found)


def test_seeds_are_in_their_order_and_have_means(seeds):
    subjects = [read_subject(seeds / name, name) for name in ("seed-1", "seed-0")]
    (group,) = grouped(subjects)
    assert group.seeds == [0, 1]
    assert group.trained == [24_000]
    mean, interval = group.mean("mean_return")
    values = [subject.summary["mean_return"] for subject in group.subjects]
    assert (mean, interval) == (sum(values) / 2, bootstrap_interval(values))
    assert group.settings["train.seed"] == "0, 1"
    assert group.settings["task.beam_indices"] == "none"


def test_what_differs_between_groups_is_named(seeds):
    first, second = subjects_of(seeds, ["a/x", "b/x"])
    noisy = replace(second.config, task=replace(second.config.task, laser_noise=0.1))
    groups = grouped([first, replace(second, config=noisy)])
    assert differences(groups) == {"task.laser_noise": ["0.0", "0.1"], "train.eval_steps": ["100", "101"]}
    assert differences(groups[:1]) == {}


def test_one_training_twice_is_refused(seeds):
    twins = [replace(subject, name=name) for name in ("first", "second") for subject in subjects_of(seeds, ["a/x"])]
    with pytest.raises(InputError, match="first and second are the same training: name one of them"):
        grouped(twins)
