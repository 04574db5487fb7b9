"""The pages of settings and commands are current and complete, and what they tell users to type works."""

import dataclasses
import inspect
import json
import re
import shlex
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

from tb2rl.__main__ import main
from tb2rl.core.agent import find_agent
from tb2rl.core.plugins import FILTERS, agent_names, import_object, task_names
from tb2rl.envs.parts import SENSORS
from tb2rl.robots.robot import Laser
from tb2rl.runs.arguments import AGENT_RESERVED
from tb2rl.runs.config import TrainSettings, parse_settings, resolve
from tb2rl.simulation.variation import Variation
from tb2rl.tasks.task import find_task
from tb2rl.worlds import ImportOptions
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings

CHECKOUT = Path(__file__).parent.parent
PAGES = {"settings": "settings --markdown", "commands": "--markdown"}
DATACLASSES = {
    "train (group)": TrainSettings,
    "variation (group)": Variation,
    "dynamic_obstacles (group)": DynamicObstacles,
    "world_file (group)": ImportOptions,
    "turtlebot2 (robot)": Laser,
    **{f"{name} (task)": find_task(name) for name in task_names()},
    **{f"{name} (world generator)": GeneratorSettings for name in GENERATORS},
}
CONSTRUCTORS = {
    **{f"{name} (agent)": (find_agent(name).load(),) for name in agent_names()},
    **{f"{name} (sensor)": classes for name, classes in SENSORS.items()},
    **{f"{name} (filter)": (import_object(reference),) for name, reference in FILTERS.items()},
}
NOT_SET_BY_USERS = {*AGENT_RESERVED, "robot", "laser", "camera", "self"}
VARIADIC = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def page(name: str) -> str:
    return (CHECKOUT / f"docs/reference/{name}.md").read_text(encoding="utf-8")


def tables() -> dict[str, list[dict[str, str]]]:
    """Rows of the page, by heading; a row has its cells by column."""
    found = {}
    for section in page("settings").split("\n## ")[1:]:
        heading, *lines = section.splitlines()
        split = [
            [cell.strip().strip("`") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines if "|" in line
        ]
        found[heading] = [dict(zip(split[0], cells, strict=True)) for cells in split[2:]]
    return found


TABLES = tables()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_what_its_command_prints(name, capsys):
    pinned = re.search(r"^stable_baselines3==(.*)$", (CHECKOUT / "constraints.txt").read_text(), flags=re.MULTILINE)
    if version("stable_baselines3") != pinned[1]:
        pytest.skip("meanings of an algorithm's arguments are those of its version")
    main(PAGES[name].split())
    assert capsys.readouterr().out == page(name)


@pytest.mark.parametrize("title", [*DATACLASSES, *CONSTRUCTORS])
def test_every_setting_has_its_default_and_a_meaning(title):
    expected = []  # name and default, None without one
    if title in DATACLASSES:
        fields = dataclasses.fields(DATACLASSES[title])
        expected = [(field.name, field.default) for field in fields]
    for cls in CONSTRUCTORS.get(title, ()):
        parameters = inspect.signature(cls.__init__).parameters.values()
        expected += [
            (p.name, p.default) for p in parameters if p.name not in NOT_SET_BY_USERS and p.kind not in VARIADIC
        ]
    shown = [(row["setting"].rpartition(".")[2], row.get("default", "")) for row in TABLES[title]]
    for name, default in expected:
        is_missing = default in (dataclasses.MISSING, inspect.Parameter.empty)
        texts = [text for key, text in shown if key == name]
        assert texts, name
        assert ("" if is_missing else json.dumps(default)) in [
            text and json.dumps(yaml.safe_load(text)) for text in texts
        ]
    assert [row["setting"] for row in TABLES[title] if not (row["meaning"] and row["type"])] == []


RUNNABLE = [title for title in TABLES if re.search(r"train|variation|obstacles|\((task|agent|filter|robot)\)", title)]


@pytest.mark.parametrize("title", RUNNABLE)
def test_the_command_lines_are_accepted(title):
    name, kind = re.fullmatch(r"(.*) \((.*)\)", title).groups()
    agent = name if kind == "agent" else "sac" if name in ("drive", "navigate") else "ppo"
    task = name if kind == "task" else {"sac": "drive", "td3": "drive", "qlearn": "maze"}.get(agent, "maze")
    if kind == "agent" and not find_agent(name).algorithm:
        task = "navigate"
    lines = [row["command line"] for row in TABLES[title] if "VALUE" not in row["command line"]]
    settings = parse_settings(word for line in lines for word in shlex.split(line)[1:])
    resolve(agent, task, settings={**settings, "task.world": "wall"})  # because to generate worlds takes time


def test_an_agent_shows_the_values_of_its_presets():
    (row,) = [row for row in TABLES["ppo (agent)"] if row["setting"] == "agent.n_steps"]
    values = [
        yaml.safe_load((CHECKOUT / f"configs/{folder}/ppo.yaml").read_text()) for folder in ("agents", "kinematic")
    ]
    assert [row["tb2rl"], row["kinematic"]] == [str(value["agent"]["n_steps"]) for value in values]


@pytest.mark.parametrize(("title", "setting"), [("qlearn (agent)", "agent.gamma"), ("wall (task)", "task.beams")])
def test_an_agent_and_a_task_show_the_values_of_each_other(title, setting):
    (row,) = [row for row in TABLES[title] if row["setting"] == setting]
    section, key = setting.split(".")
    preset = yaml.safe_load((CHECKOUT / "configs/tasks/wall-qlearn.yaml").read_text())
    assert preset[section][key] in yaml.safe_load(row["task with agent"]).values()


def test_an_unknown_name_is_refused(refused):
    refused(main, "settings ppoo", ["unknown settings 'ppoo'; did you mean 'ppo'?"])
    refused(main, "settings missing:Task", ["missing"])


TASK = """
from dataclasses import dataclass
from tb2rl.tasks.wander import Wander

@dataclass(frozen=True)
class Mine(Wander):
    bonus: float = 2.5  # [1/m] reward per metre
    forward_speed: float = 0.25
"""


def test_a_task_of_ones_own_is_listed(module_folder, monkeypatch, capsys):
    (module_folder / "my_task.py").write_text(TASK)
    monkeypatch.setenv("COLUMNS", "120")
    main(["settings", "my_task:Mine"])
    shown = capsys.readouterr().out
    assert re.search(r"--set task\.bonus=2\.5 +│ reward per metre \[1/m\]", shown)
    assert re.search(r"--set task\.forward_speed=0\.25 +│ speed of the action `forward` \[m/s\]", shown)


def test_without_a_name_all_names_are_listed(capsys):
    main(["settings"])
    listed = re.split(r"[\s,:]+", capsys.readouterr().out)
    assert [title for title in TABLES if title.split()[0] not in listed] == []
