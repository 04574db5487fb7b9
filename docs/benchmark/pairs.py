"""The pairs of the benchmark: an agent, a rule or another program, and a task that it can drive."""

from itertools import product

from peers import entrants

from tb2rl.core import InputError, agent_names, find_agent, task_names, top_folder
from tb2rl.runs import Config, make_baseline, resolve
from tb2rl.runs.algorithm import check_trainable

Pair = tuple[str, str]  # names of an agent or a program, and of a task
PILOT = -1  # seed of the row that has the number of steps
# Presets with the algorithm and the parameters of the ROS tutorial, by task.
TUTORIAL, TUTORIAL_PRESETS = "tutorial", {"maze": "tutorial", "wall": "tutorial-wall"}


def find_pairs() -> list[Pair]:
    """All valid pairs."""
    pairs = [*product(agent_names(), task_names()), *((TUTORIAL, task) for task in TUTORIAL_PRESETS)]
    return [*(pair for pair in pairs if find_config(*pair)), *entrants()]


def find_preset(name: str, task: str) -> str | None:
    """The preset that is made for a pair, if there is one."""
    preset = TUTORIAL_PRESETS[task] if name == TUTORIAL else f"{task}-{name}"
    return preset if (top_folder("configs") / f"{preset}.yaml").is_file() else None


def find_config(name: str, task: str, **settings: object) -> Config | None:
    """The config of a pair in the kinematic simulator; None if the agent cannot drive at the task."""
    train = {f"train.{key}": value for key, value in {"simulation": "kinematic", **settings}.items()}
    try:
        config = resolve(None if name == TUTORIAL else name, task, find_preset(name, task), train)
        if config.agent.algorithm is None:
            make_baseline(config)
        else:
            check_trainable(config)
    except InputError:
        return None
    return config


def is_rule(name: str) -> bool:
    """Whether an agent does not learn."""
    return name in agent_names() and find_agent(name).algorithm is None
