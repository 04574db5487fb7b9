"""Loads and runs a policy that `tb2rl.export` wrote to a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Mapping

import numpy as np

from tb2rl.envs.filters import Filter

from .encoding import Encoding
from .network import LayerArrays, Network
from .policy_contract import Needs, SensorData, Speeds

POLICY_FORMAT = 1  # of `policy.json`


class ExportedPolicy:
    """A policy from `python -m tb2rl.export POLICY FOLDER`; acts as the policy itself does, greedily.

    Args:
        folder: The folder.

    Attributes:
        about: The content of `policy.json`.
        needs: Its requirements.
        filters: The filters of its commands.
        observed: The last observation, shape (1, n).

    Raises:
        ValueError: If the folder does not hold such a policy, or a later program wrote it.
    """

    def __init__(self, folder: str | Path) -> None:
        try:
            self.about = json.loads((Path(folder) / "policy.json").read_text(encoding="utf-8"))
            if self.about["format"] != POLICY_FORMAT:
                raise ValueError(f"format {self.about['format']}; this program reads {POLICY_FORMAT}")
            with (Path(folder) / "weights.npz").open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                weights = {name: arrays[name] for name in arrays.files}
            self.needs = Needs(**{**self.about["needs"], "beams": np.array(self.about["needs"]["beams"])})
            self.filters = [_filter(entry) for entry in self.about.get("filters", ())]
            self._encoding = Encoding(self.about["observation"], self.needs)
            self._network = Network([_layer(layer, weights) for layer in self.about["layers"]])
        except Exception as error:  # json, zipfile, zlib and numpy raise a dozen kinds of errors for damaged files
            raise ValueError(f"{folder} is not a folder of tb2rl.export, or is damaged: {error}") from None

    def reset(self) -> None:
        """Start a new episode."""
        self._encoding.reset()
        self._network.reset()

    def act(self, sensed: SensorData) -> Speeds:
        """The command of the next control step; called once per step."""
        self.observed = self._encoding(sensed)
        (action,) = self._network(self.observed)
        actions = self.about["actions"]
        if "commands" in actions:
            v, w = actions["commands"][action]
        else:
            low, high = np.array(actions["low"]), np.array(actions["high"])
            v, w = low + (np.clip(action, -1.0, 1.0).astype(float) + 1.0) / 2.0 * (high - low)
        return float(v), float(w)


def _layer(layer: Mapping[str, Any], weights: Mapping[str, np.ndarray]) -> LayerArrays:
    return layer["kind"], {name: weights[key] for name, key in layer["arrays"].items()}


def _filter(entry: Mapping[str, Any]) -> Filter:
    """A filter by its class, whose file `tb2rl.export` packed into this program, and its arguments."""
    classes = {each.__name__: each for each in Filter.__subclasses__()}
    return classes[entry["class"]](**entry["arguments"])
