"""A policy that was exported to a folder, ready to drive; numpy is all that it needs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Mapping, Union

import numpy as np

from .encoding import Encoding
from .network import Network
from .policy_contract import Needs, Sensed, Speeds

POLICY_FORMAT = 1  # of `policy.json`


class ExportedPolicy:
    """What `python -m tb2rl.export POLICY FOLDER` wrote; it acts as the policy itself does, greedily.

    Args:
        folder: The folder.

    Attributes:
        about: What `policy.json` says.
        needs: What it needs of a robot.
        observed: What it made of what was sensed last, shape (1, n): what the network, or the table, is given.

    Raises:
        ValueError: If the folder does not hold such a policy, or one that a later runner wrote.
    """

    def __init__(self, folder: Union[str, Path]) -> None:
        try:
            self.about = json.loads((Path(folder) / "policy.json").read_text(encoding="utf-8"))
            if self.about["format"] != POLICY_FORMAT:
                raise ValueError("format {}; this runner reads {}".format(self.about["format"], POLICY_FORMAT))
            with np.load(str(Path(folder) / "weights.npz"), allow_pickle=False) as arrays:
                weights = {name: arrays[name] for name in arrays.files}
            self.needs = Needs(**{**self.about["needs"], "beams": np.array(self.about["needs"]["beams"])})
            self._encoding = Encoding(self.about["observation"], self.needs)
            self._network = Network([_layer(layer, weights) for layer in self.about["layers"]])
        except Exception as error:  # json, zipfile, zlib and numpy raise a dozen kinds of errors for damaged files
            raise ValueError("{} is not a folder of tb2rl.export, or is damaged: {}".format(folder, error)) from None

    def begin(self) -> None:
        """Forget the last episode; the next `act` is the first of a new one."""
        self._encoding.begin()
        self._network.begin()

    def act(self, sensed: Sensed) -> Speeds:
        """The speeds for the next control step; called once for each."""
        self.observed = self._encoding(sensed)
        (action,) = self._network(self.observed)
        actions = self.about["actions"]
        if "commands" in actions:
            v, w = actions["commands"][action]
        else:
            low, high = np.array(actions["low"]), np.array(actions["high"])
            v, w = low + (np.clip(action, -1.0, 1.0).astype(float) + 1.0) / 2.0 * (high - low)
        return float(v), float(w)


def _layer(layer: Mapping[str, Any], weights: Mapping[str, np.ndarray]) -> Any:
    """The kind of a layer, and its arrays by name."""
    return layer["kind"], {name: weights[key] for name, key in layer["arrays"].items()}
