"""Studies of trainings that are over in a moment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tb2rl.runs.layers import as_preset
from tb2rl.tuning.study import Plan, Search

TINY = {
    "train.simulation": "kinematic", "train.n_envs": 8, "train.total_timesteps": 1024, "train.eval_freq": 256,
    "train.eval_episodes": 5, "train.eval_steps": 30, "train.stop_score": None,
}  # fmt: skip
SPACE = {"agent.gamma": {"low": 0.8, "high": 0.99}, "agent.averaging": {"choices": [None, 0.01, 0.1]}}


def _search(
    name: str = "it",
    space: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    agent: str = "qlearn",
    **plan: Any,
) -> Search:
    """A study of short trainings in `runs/tune`."""
    default = as_preset(agent, "maze", settings={**TINY, **(settings or {})})
    return Search.begin(Path("runs", "tune", name), Plan(dict(space or SPACE), **{"seeds": 1, **plan}), default)


@pytest.fixture
def search(tmp_path, monkeypatch):
    """The function `_search`, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return _search


@pytest.fixture
def tiny() -> list[str]:
    """The settings of short trainings as the command line has them."""
    return [f"{key}={'null' if value is None else value}" for key, value in TINY.items() if "simulation" not in key]
