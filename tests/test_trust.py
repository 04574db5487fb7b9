"""Configs name modules: nothing is imported from a run folder, and untrusted configs name only common modules."""

import re
import shutil
import sys
from importlib import import_module

import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.core.plugins import import_object
from tb2rl.core.trust import block_imports, untrusted_source
from tb2rl.runs.loading import load
from tb2rl.tasks.task import find_task
from tb2rl.training.training import resume

TASK = """
from pathlib import Path
from tb2rl.tasks.wander import Wander

Path(__file__).with_name("executed").touch()

class Mine(Wander):
    pass
"""


@pytest.fixture
def evil(module_folder):
    """A folder on the path with a module that is not trusted."""
    (module_folder / "evil.py").write_text(TASK)
    return module_folder


@pytest.mark.parametrize(
    ("task", "place", "module"),
    [("evil:Mine", "best", "evil"), ("run.evil:Mine", "", r"run\.evil"), ("mine:Mine", "", "evil")],
)
def test_no_module_in_a_run_folder_is_imported_by_whatever_way(task, place, module, module_folder, monkeypatch):
    (module_folder / "mine.py").write_text("from evil import Mine\n")
    run = shutil.copytree(top_folder("zoo") / "maze-loop-qlearn", module_folder / "run")
    (run / "config.yaml").write_text(re.sub("(?m)^  name: maze$", f"  name: {task}", (run / "config.yaml").read_text()))
    (run / place / "evil.py").write_text(TASK)
    monkeypatch.syspath_prepend(run / place)
    for attempt in (load, resume):
        with pytest.raises(InputError, match=rf"'{module}' lies in .*run, and nothing is imported from a run folder"):
            attempt(run)
    assert "evil" not in sys.modules
    assert not list(module_folder.rglob("executed"))


def test_a_module_beside_a_run_folder_is_imported(evil):
    with block_imports(evil / "run"):
        assert find_task("evil:Mine").__name__ == "Mine"
    assert (evil / "executed").exists()


def test_an_untrusted_config_may_name_common_modules():
    with untrusted_source("ada"):
        for reference in ("tb2rl.agents.qlearn:QLearning", "stable_baselines3:PPO", "torch.nn:ReLU"):
            assert import_object(reference).__name__ == reference.partition(":")[2]


def test_an_untrusted_config_may_name_no_other_module(evil):
    own = "__main__:Mine", "evil:Mine", "tb2rl.evil:Mine", "tb2rl.zoo.sharing:push"  # the third is beside a checkout
    for reference in ("os:system", *own, "torches:X", "x" * 10_000 + ":X", ""):
        with untrusted_source("ada"), untrusted_source("bob"), pytest.raises(InputError) as refused:
            import_object(reference)
        assert str(refused.value).startswith("ada names the module '" + reference.partition(":")[0][:50])
        assert str(refused.value).endswith("trust=True, or --trust")
        assert len(str(refused.value)) < 400
    assert not (evil / "executed").exists()
    assert import_object("evil:Mine") is import_module("evil").Mine, "the limit ends with its block"


def test_no_reference_runs_the_program_of_a_package():
    with untrusted_source("ada"), pytest.raises(InputError, match="it should read module:Class"):
        import_object("torch.utils.__main__:main")


def test_an_installed_plugin_is_trusted(write_package):
    write_package("[tb2rl.tasks]\nmine = mine:Mine\n", mine=TASK)
    with untrusted_source("ada"):
        assert find_task("mine") is find_task("mine:Mine")


@pytest.mark.parametrize("kind", ["filters", "simulators"])
def test_plugins_of_all_kinds_in_configs_are_trusted(write_package, kind):
    write_package(f"[tb2rl.{kind}]\nmine = mine:Mine\n", mine=TASK)
    with untrusted_source("ada"):
        assert import_object("mine:Mine").__name__ == "Mine"
