"""Loads and runs a policy that `tb2rl.export` wrote to a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np

from tb2rl.envs.filters import Filter

from .encoding import Encoding
from .network import Network
from .policy_contract import Needs, SensorData, Speeds

POLICY_FORMAT = 1  # of `policy.json`


class ExportedPolicy:
    """A policy that `python -m tb2rl.export POLICY FOLDER` wrote; acts greedily, that is, without exploration.

    Args:
        folder: The folder.

    Attributes:
        needs: The requirements of the policy.
        filters: The filters of the commands.
        observation: The last observation, shape (1, n).

    Raises:
        ValueError: If the folder does not hold such a policy, or a version of tb2rl with another format wrote it.
    """

    def __init__(self, folder: str | Path) -> None:
        try:
            description = json.loads((Path(folder) / "policy.json").read_text(encoding="utf-8"))
            if description["format"] != POLICY_FORMAT:
                raise ValueError(f"its format is {description['format']}, and this program reads {POLICY_FORMAT}")
            layers: List[Tuple[str, Dict[str, np.ndarray]]] = [(layer_type, {}) for layer_type in description["layers"]]
            with (Path(folder) / "weights.npz").open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                for key in arrays.files:
                    index, name = key.split(".")
                    layers[int(index)][1][name] = arrays[key]
            self.needs = Needs(**{**description["needs"], "beams": np.array(description["needs"]["beams"])})
            classes = {each.__name__: each for each in Filter.__subclasses__()}  # also those packed into this program
            self.filters = [classes[each["class"]](**each["arguments"]) for each in description.get("filters", ())]
            self._actions = description["actions"]
            self._encoding = Encoding(description["observation"], self.needs)
            self._network = Network(layers)
        except Exception as error:  # json, zipfile, zlib and numpy raise a dozen kinds of errors for damaged files
            raise ValueError(f"{folder} is not a folder of tb2rl.export, or is damaged: {error}") from None

    def reset(self) -> None:
        """Start a new episode."""
        self._encoding.reset()
        self._network.reset()

    def act(self, sensor_data: SensorData) -> Speeds:
        """The command of the next control step; called once per step."""
        self.observation = self._encoding(sensor_data)
        (action,) = self._network(self.observation)
        if "commands" in self._actions:
            v, w = self._actions["commands"][action]
        else:
            low, high = np.array(self._actions["low"]), np.array(self._actions["high"])
            v, w = low + (np.clip(action, -1.0, 1.0).astype(float) + 1.0) / 2.0 * (high - low)
        return float(v), float(w)
