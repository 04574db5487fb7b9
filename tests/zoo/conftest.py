"""The command of the zoo, and zoos of its own."""

from importlib import import_module

import pytest

from tb2rl.runs import loading
from tb2rl.zoo import entry


@pytest.fixture
def main():
    """The command `python -m tb2rl.zoo`."""
    return import_module("tb2rl.zoo.__main__").main


@pytest.fixture
def own_zoo(workdir, monkeypatch):
    """The empty folder of another zoo; trainings go beside it."""
    zoo = workdir / "zoo"
    zoo.mkdir()
    (zoo / "recipes.yaml").write_text("")
    for module in (entry, loading):
        monkeypatch.setattr(module, "top_folder", lambda name: zoo)
    return zoo
