"""Lies that cost memory or time, or have something imported, opened or overwritten: in the config, and in the state."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from surgery import Case, agents, at, changed_at, checkpoint_of, header_content, packed, places, split, with_content

CLAIMS: dict[str, list[Any]] = {
    "train.n_envs": [10**6, 10**9, 10**18, 10**30],
    "train.torch_threads": [10**9],
    "train.device": ["cuda", "cuda:99", "meta", "nowhere"],
    "task.beams": [10**7, 10**9, 10**12, 2**63],
    "task.beam_indices": [[10**12], [0] * 10**6, [2**63]],
    "task.range_bins": [[float(i + 1) for i in range(10**4)]],
    "task.world": ["", "\0", ".", "/", "/dev/zero", "/etc/passwd", "x" * 300 + ".yaml", "a/" * 5000, "os:getcwd"],
    "task.robot": ["", ":", "os:getcwd", "tb2rl.robots:Robot", "x" * 10**6],
    "task.name": ["", ":", "os:mkdir", "tb2rl.tasks:Task", "asyncio.windows_events:X"],
    "task.observation": ["x" * 10**6],
    "agent.name": [
        "random", "qlearn", "dqn", "ppo", "stable_baselines3:A2C", "stable_baselines3:SAC", ":", "::", "a:b:c",
        "stable_baselines3.common.off_policy_algorithm:OffPolicyAlgorithm", "os:mkdir", "torch:load", "sys:modules",
        "tb2rl.agents.dqn:AGENT", "..:x", "x" * 10**6, "dqn\nppo", "asyncio.windows_events:X", "unittest.__main__:main",
    ],
    "agent.buffer_size": [10**8, 10**9, 10**12, 0, -1],
    "agent.n_steps": [10**9, 10**12, 0, -1],
    "agent.stats_window_size": [10**9, -1],
    "agent.replay_buffer_class": ["stable_baselines3:HerReplayBuffer", "os:mkdir"],
    "agent.policy_kwargs": [None, 3, [], {"x": 1}, {"lr_schedule": 1}],
    "agent.policy_kwargs.net_arch": [
        [10**6, 10**6], [20_000] * 3, [10**9], [10**18], [2**63], [8] * 10**4, [0], [-1], ["x"],
        {"pi": [10**6, 10**6], "vf": [8]}, {"pi": 3, "vf": None},
    ],
    "agent.policy_kwargs.activation_fn": ["torch.nn:Linear", "torch.nn:Module", "torch:load"],
    "agent.policy_kwargs.features_extractor_class": ["torch.nn:Linear", "torch.nn:Module", "torch:load"],
    "agent.policy_kwargs.features_extractor_kwargs": [{"x": 1}, {"middle": "x"}],
    "agent.policy_kwargs.optimizer_class": ["torch.optim:LBFGS", "torch.nn:Linear", "torch:load"],
}  # fmt: skip

STATES: dict[str, list[Any]] = {
    "timesteps": [-1, 10**30, True, 1.5, None],
    "training": [None, [], {}],
    "training/others": [None, {}, {"policy.optimizer": {}}],
    "training/others/policy.optimizer/param_groups/0/lr": ["x", -1.0, float("nan"), 10**400],
    "training/others/policy.optimizer/param_groups/0/params": [[], [0, 0, 0, 0], [10**30]],
    "training/others/policy.optimizer/param_groups/0/fused": [True],
    "training/others/policy.optimizer/param_groups": [None, [], [{}]],
    "training/others/policy.optimizer/state": [None, [], {"0": {}}, {"$pairs": [[0, {}]]}, {"$pairs": [[0, 3]]}],
    "training/algorithm/num_timesteps": [-(10**18), 10**18],
    "training/algorithm/_episode_num": [-1, 10**30],
    "training/algorithm/_n_updates": [-1, 10**30],
    "training/algorithm/exploration_rate": [float("nan"), -1, 10**400],
    "training/algorithm/_current_progress_remaining": [float("nan"), -(10**18), 10**400],
    "training/algorithm/batch_size": [10**12, -1],
    "training/algorithm/n_steps": [10**12, -1],
    "training/algorithm/n_epochs": [10**12],
    "training/algorithm/buffer_size": [10**12],
    "training/algorithm/gradient_steps": [10**12],
    "training/algorithm/learning_starts": [10**30],
    "training/algorithm/ep_info_buffer": [[1], [{}], [{"r": "x", "l": None}], [{"r": float("nan")}], {}],
    "training/algorithm/_last_obs": [{"$array": "0"}, None],
    "training/algorithm/_last_episode_starts": [{"$array": "0"}, None],
    "training/algorithm/learn": [1, {"$array": "0"}],
    "training/replay_buffer": [None, {}, {"pos": 1}],
    "training/replay_buffer/pos": [10**12, -1, 39, 40, 41],
    "training/replay_buffer/full": [True, 3],
    "training/replay_buffer/buffer_size": [10**12, 0, 1],
    "training/replay_buffer/n_envs": [10**12, 0, 1],
    "training/replay_buffer/observations": [None, {"$array": "0"}],
    "training/generators/python/1": [[], [0] * 625, [-1] * 625, [2**64] * 625],
    "training/generators/numpy": [None, {}, "x"],
    "training/generators/numpy/state/pos": [10**9, -1, 625],
    "training/generators/torch": [{"$array": "0"}, None],
    "training/generators/actions": [None, {"bit_generator": "MT19937"}],
    "training/environments": [None, [], {}],
    "training/environments/reading/ranges": [{"$array": "0"}, None],
    "training/callbacks": [None, [], [{}, {}]],
    "training/callbacks/0/lengths": [None, [{}], [10**400] * 3],
    "training/callbacks/1/next": [10**400, float("nan"), -1, float("inf")],
}  # fmt: skip
KINDS = {"F32": "float32", "F64": "float64", "I64": "int64", "U32": "uint32", "U64": "uint64"}
KINDS |= {"BOOL": "bool", "U8": "uint8"}


def claims(runs: Path) -> Iterator[Case]:
    """A config that claims what it likes, over true arrays."""
    for agent in agents(runs):
        header, data = split(checkpoint_of(runs, agent).read_bytes())
        content = header_content(header)
        for key, values in CLAIMS.items():
            for value in values:
                changed = deepcopy(content)
                *branch, last = key.split(".")
                place = changed["config"]
                for name in branch:
                    place = place.setdefault(name, {})
                place[last] = value
                yield Case(f"{key}={value!r}"[:80], agent, with_content(header, data, changed))


def states(runs: Path) -> Iterator[Case]:
    """The state of a training that claims what it likes, and each of its arrays with another type, shape or content."""
    for agent in agents(runs):
        header, data = split(checkpoint_of(runs, agent).read_bytes())
        content = header_content(header)
        for place, values in STATES.items():
            path = [int(key) if key.isdigit() else key for key in place.split("/")]
            for value in values:
                with suppress(KeyError, IndexError, TypeError):  # another agent's
                    changed = changed_at(content, path, value)
                    yield Case(f"{place}={value!r}"[:90], agent, with_content(header, data, changed), resumes=True)
        for path in places(content):
            layer = path[5] if path[:2] == ["training", "others"] and len(path) > 5 else 0
            if path[0] == "training" and path[-1] == "$array" and layer == 0:  # optimisers treat all layers alike
                yield from strange_arrays(agent, header, data, path, at(content, path))


def strange_arrays(agent: str, header: dict[str, Any], data: bytes, path: list[Any], name: str) -> Iterator[Case]:
    entry, place = header[name], "/".join(map(str, path[1:-1]))
    first, last = entry["data_offsets"]
    array = np.frombuffer(data[first:last], KINDS[entry["dtype"]]).reshape(entry["shape"])
    if array.dtype.kind == "f":
        others = [np.full_like(array, value) for value in (np.nan, np.inf, -np.inf, np.finfo(array.dtype).max)]
    else:
        extremes = (0, 1) if array.dtype.kind == "b" else (np.iinfo(array.dtype).min, np.iinfo(array.dtype).max)
        others = [np.full_like(array, value) for value in extremes]
    others += [array.astype(np.float32), array.astype(np.int64), array.astype(bool), array.astype(np.uint8)]
    others += [array[..., None], array[None], array.ravel(), array.reshape(-1)[:0], array.reshape(-1)[0:1].reshape(())]
    others += [array[:-1], np.repeat(array, 2, axis=0)] if array.ndim else []
    others += [array[:, :0], array[:, :-1]] if array.ndim > 1 else []
    kinds = {numpy: name for name, numpy in KINDS.items()}
    for other in others:
        changed = {**header, name: {"dtype": kinds[other.dtype.name], "shape": list(other.shape)}}
        shown = f"{place}: {other.dtype} {other.shape} {other.reshape(-1)[:1]}"
        yield Case(shown, agent, packed(changed, {name: other.tobytes()}, data), resumes=True)
