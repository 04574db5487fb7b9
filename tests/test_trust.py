"""Configs name modules: nothing is imported from a run folder, and untrusted configs name only common modules."""

from __future__ import annotations

import shutil
import sys
from importlib import import_module

import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.core.plugins import import_object
from tb2rl.core.trust import block_imports, untrusted_source
from tb2rl.runs.loading import load
from tb2rl.tasks.registry import find_task
from tb2rl.training.training import resume

TASK = """
from pathlib import Path

from tb2rl.tasks.wander import Wander

Path(__file__).with_name("executed").touch()

class Mine(Wander):
    pass
"""


@pytest.fixture
def importable(monkeypatch):
    """A function that lets Python import from a folder until the test ends."""
    known = set(sys.modules)
    yield lambda folder: monkeypatch.syspath_prepend(str(folder))
    for name in set(sys.modules) - known:
        if name.split(".")[0] in ("evil", "run", "mine"):
            del sys.modules[name]


@pytest.fixture
def evil(importable, tmp_path):
    """A folder on the path with a module that is not trusted."""
    (tmp_path / "evil.py").write_text(TASK)
    importable(tmp_path)
    return tmp_path


def edited_run(folder, task: str):
    """A copy of a policy of the zoo whose config names another task, with a module that has such a task."""
    run = shutil.copytree(top_folder("zoo") / "maze-loop-qlearn", folder / "run")
    config = run / "config.yaml"
    config.write_text(config.read_text().replace("  name: maze\n", f"  name: {task}\n"))
    (run / "evil.py").write_text(TASK)
    return run


@pytest.mark.parametrize("inside", ["", "best"])
def test_a_module_in_a_run_folder_is_not_imported_even_from_the_path(inside, importable, tmp_path):
    run = edited_run(tmp_path, "evil:Mine")
    importable((run / "evil.py").rename(run / inside / "evil.py").parent)
    for attempt in (load, resume):
        with pytest.raises(InputError, match=r"'evil' lies in .*run, and nothing is imported from a run folder"):
            attempt(run)
    assert "evil" not in sys.modules
    assert not list(run.rglob("executed"))


def test_nor_by_a_package_or_a_module_outside_that_leads_into_it(importable, workdir):
    run = edited_run(workdir, "run.evil:Mine")
    importable(run)
    importable(workdir)
    with pytest.raises(InputError, match=r"'run\.evil' lies in"):
        load("run")
    (workdir / "mine.py").write_text("from evil import Mine\n")
    (run / "config.yaml").write_text((run / "config.yaml").read_text().replace("run.evil:Mine", "mine:Mine"))
    with pytest.raises(InputError, match="'evil' lies in"):
        load(run)
    assert not (run / "executed").exists()


def test_a_module_beside_a_run_folder_is_imported(importable, tmp_path):
    edited_run(tmp_path, "mine:Mine")
    (tmp_path / "mine.py").write_text(TASK)
    importable(tmp_path)
    with block_imports(tmp_path / "run"):
        assert find_task("mine:Mine").__name__ == "Mine"
    assert (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    "reference",
    ["tb2rl.tasks.wander:Wander", "tb2rl.agents.qlearn:QLearning", "stable_baselines3:PPO", "torch.nn:ReLU"],
)
def test_an_untrusted_config_may_name_common_modules(reference):
    with untrusted_source("ada"):
        assert import_object(reference).__name__ == reference.partition(":")[2]


@pytest.mark.parametrize(
    "reference",
    [
        "os:system",
        "__main__:Mine",
        "evil:Mine",
        "torches:X",
        "tb2rl:X",
        "tb2rl.evil:Mine",  # a file in the folder around a checkout
        "tb2rl.zoo.sharing:push",
        "x" * 10_000 + ":X",
        "",
    ],
    ids=lambda reference: reference[:20],
)
def test_an_untrusted_config_may_name_no_other_module(reference, evil):
    with untrusted_source("ada"), pytest.raises(InputError) as refused:
        import_object(reference)
    message = str(refused.value)
    assert message.startswith("ada names the module ")
    assert reference.partition(":")[0][:50] in message
    assert message.endswith("say so with trust=True, or --trust")
    assert len(message) < 400
    assert not (evil / "executed").exists()


def test_the_outer_source_is_named_and_the_limit_ends_with_its_block(evil):
    with untrusted_source("ada"), untrusted_source("bob"), pytest.raises(InputError, match=r"^ada names"):
        import_object("evil:Mine")
    assert import_object("evil:Mine") is import_module("evil").Mine


def test_an_installed_plugin_is_trusted(write_package):
    write_package("[tb2rl.tasks]\nmine = mine:Mine\n", mine=TASK)
    with untrusted_source("ada"):
        assert find_task("mine") is find_task("mine:Mine")
