"""Runs that differ in nothing but their seed, shown together: their means, and what tells one group from another."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs.config import Config
from tb2rl.viz.palettes import GROUPS, colours
from tb2rl.viz.subjects import Subject, shared_path, without_seed


@dataclass(frozen=True)
class Group:
    """Runs that differ in nothing but their seed."""

    name: str
    colour: str
    subjects: Sequence[Subject]

    @property
    def config(self) -> Config:
        """What they share; its seed is the first one's."""
        return self.subjects[0].config

    @property
    def seeds(self) -> list[int]:
        """The seed of each."""
        return [subject.config.train.seed for subject in self.subjects]

    @property
    def trained(self) -> list[int]:
        """Control steps of the shortest and of the longest training, once if they are equal."""
        steps = [subject.trained for subject in self.subjects]
        return sorted({min(steps), max(steps)})

    @property
    def settings(self) -> dict[str, str]:
        """Everything that was decided, and the versions that ran it, by dotted key."""
        return {
            **_flat(self.config.to_dict()),
            "train.seed": ", ".join(map(str, self.seeds)),
            **_flat({"version": self.subjects[0].versions}),
        }

    def mean(self, figure: str) -> tuple[float, tuple[float, float]]:
        """Mean and 95 % bootstrap interval of a figure of `Evaluation.summary` over the runs."""
        values = [subject.summary[figure] for subject in self.subjects]
        return float(np.mean(values)), bootstrap_interval(values)


def grouped(subjects: Iterable[Subject]) -> list[Group]:
    """Put runs that differ in nothing but their seed together, in the order of their seeds.

    Raises:
        InputError: If two do not even differ in that: their mean would count one training twice.
    """
    together: dict[str, dict[int, Subject]] = {}
    for subject in subjects:
        seeds = together.setdefault(json.dumps(without_seed(subject), sort_keys=True), {})
        seed = subject.config.train.seed
        if seed in seeds:
            raise InputError(f"{seeds[seed].name} and {subject.name} are the same training: name one of them")
        seeds[seed] = subject
    members = [[seeds[seed] for seed in sorted(seeds)] for seeds in together.values()]
    everyone = [subject.name for seeds in together.values() for subject in seeds.values()]
    names = [_name([subject.name for subject in seeds.values()], everyone) for seeds in together.values()]
    return [Group(*parts) for parts in zip(names, colours(len(members), GROUPS), members, strict=True)]


def _name(names: Sequence[str], everyone: Sequence[str]) -> str:
    """What the names of some runs have in common, and those of no others."""
    shared = shared_path(names)
    theirs = [name for name in everyone if shared and shared_path([shared, name]) == shared]
    return shared if len(names) == 1 or theirs == list(names) else f"{names[0]} and {len(names) - 1} more"


def differences(groups: Sequence[Group]) -> dict[str, list[str]]:
    """The settings in which groups differ, by dotted key, with the value in each group."""
    trees = [group.settings for group in groups]
    keys = sorted({key for tree in trees for key in tree} - {"train.seed"})
    rows = {key: [tree.get(key, "") for tree in trees] for key in keys}
    return {key: values for key, values in rows.items() if len(set(values)) > 1}


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """The values of a tree by dotted key, as text."""
    flat: dict[str, str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = "none" if value is None else str(value)
    return flat
