"""What the page offers: policies, worlds, robots, simulators, variation. A page can only choose among these."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from tb2rl.core import InputError, agent_names, find_agent, simulator_names
from tb2rl.core.files import top_folder
from tb2rl.runs import config_of, load, resolve
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.folder import CONFIG, read_config
from tb2rl.simulation.simulator import find_simulator
from tb2rl.viz.viewer.drive import Selection
from tb2rl.worlds.generators import GENERATORS
from tb2rl.worlds.registry import world_extensions, world_names

AS_TRAINED = "as trained"
_GENERATED = "generated: "  # prefix of generators, because a world has the name of one
_RULE = " (a rule)"  # suffix of agents that do not learn
MIXED = f"{_GENERATED}mixed"  # worlds of all kinds


def policy_names() -> list[str]:
    """Agents that do not learn, policies of the zoo, and runs in the working directory."""
    zoo = sorted(f"zoo:{folder.name}" for folder in top_folder("zoo").iterdir() if (folder / CONFIG).is_file())
    runs = sorted(file.parent.as_posix() for file in Path("runs").glob(f"**/{CONFIG}"))
    return [*filter(is_baseline, agent_names()), *zoo, *runs]


def is_baseline(name: str) -> bool:
    """Whether a name is that of an agent that does not learn."""
    try:
        return name in agent_names() and find_agent(name).algorithm is None
    except InputError:  # a plugin that cannot be imported
        return False


def option_of(policy: str) -> str:
    """The option of the page for the name of a policy."""
    return f"{policy}{_RULE}" if is_baseline(policy) else policy


def policy_of(option: str) -> str:
    """The name of the policy of an option."""
    return option.removesuffix(_RULE)


def describe(selection: Selection) -> str:
    """What the policy of a selection is."""
    config = getattr(selection.policy, "trained_with", None)
    if config is None:
        return "A rule, which has learned nothing."
    return f"Learned by {config.agent_name} at task {config.task_name}, in {config.scene.worlds_title}."


def worlds() -> list[str]:
    """Generators, built-in worlds, and files of worlds in the working directory."""
    files = sorted(file.name for file in Path().iterdir() if file.suffix in world_extensions() and file.is_file())
    return [*(f"{_GENERATED}{name}" for name in GENERATORS), *world_names(), *files]


def simulators() -> list[str]:
    """Simulators that can run here."""
    return [name for name in simulator_names() if _can_run(name)]


def _can_run(name: str) -> bool:
    with suppress(InputError):
        simulator = find_simulator(name)
        return not simulator.is_external and simulator.unavailable() is None
    return False


def world_setting(name: str, difficulty: float, seed: int) -> Any:
    """The value of `task.world` for an option of the page."""
    if not name.startswith(_GENERATED):
        return name
    settings = {"generator": name.removeprefix(_GENERATED), "worlds": 1, "seed": seed}
    return {**settings, "difficulty": (difficulty, difficulty)}


def is_generated(name: str) -> bool:
    """Whether an option of the page is a generator, with difficulty and seed."""
    return name.startswith(_GENERATED)


def make_selection(name: str, task: str, settings: Mapping[str, Any], simulation: Any) -> Selection:
    """Load a policy, with changed settings of its task.

    Args:
        name: A policy of `policy_names`, or one on the hub.
        task: Task of an agent that does not learn.
        settings: Changed settings of the task.
        simulation: The simulator.

    Raises:
        InputError: If the policy cannot be loaded, or the settings do not fit.
    """
    simulator = find_simulator(simulation)
    if name in agent_names():
        config = resolve(name, task, settings={f"task.{key}": value for key, value in settings.items()})
        return Selection(make_baseline(config), config, simulator, name)
    policy = load(name)
    return Selection(policy, config_of(policy).with_task(settings), simulator, name)


def with_settings(selection: Selection, settings: Mapping[str, Any], simulation: Any) -> Selection:
    """A copy with changed settings of the task, in another simulator."""
    config = selection.config.with_task(settings)
    policy = make_baseline(config) if is_baseline(selection.label) else selection.policy
    return replace(selection, policy=policy, config=config, simulator=find_simulator(simulation))


def policy_of_task(task: str) -> str:
    """The first policy of the zoo that was trained at a task, or else an agent that can drive at any task."""
    entries = sorted(folder for folder in top_folder("zoo").iterdir() if (folder / CONFIG).is_file())
    return next((f"zoo:{entry.name}" for entry in entries if read_config(entry)["task"]["name"] == task), "random")
