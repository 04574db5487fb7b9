"""A training as a run of Weights & Biases: offline, in the run folder, unless `WANDB_MODE` says otherwise."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any
from uuid import uuid4

import numpy as np

from tb2rl.training.trackers import Tracked, Tracker, tracker_troubles_named

os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # read as it is imported: its errors are not sent anywhere

import wandb

# Figures alone: nothing of the terminal, of the code around it, of the machine and of what is installed there.
_QUIET = {
    "silent": True, "console": "off", "disable_git": True, "disable_code": True, "disable_job_creation": True,
    "x_disable_meta": True, "x_disable_stats": True, "x_disable_machine_info": True, "x_save_requirements": False,
}  # fmt: skip
_EXIT = {"finished": 0, "interrupted": 255, "failed": 1}  # 255: Weights & Biases calls the run killed


class Wandb(Tracker):
    """Each part of a resumed training is a folder `wandb/offline-run-*` of its own, all with the id of one run.

    The project is that of `WANDB_PROJECT`, else "tb2rl".
    """

    def __init__(self, training: Tracked) -> None:
        super().__init__(training)
        with self._troubles_named():
            self._run = wandb.init(
                project=os.environ.get("WANDB_PROJECT") or "tb2rl",
                dir=training.folder,
                id=self.id or uuid4().hex[:8],
                name=training.name,
                config=dict(training.settings),
                resume="allow",
                reinit="create_new",  # beside others in this process
                settings=wandb.Settings(mode=os.environ.get("WANDB_MODE") or "offline", **_QUIET),
            )
        self.remember(self._run.id, self._told)

    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        with self._troubles_named():
            shown = {key: wandb.Image(picture) for key, picture in pictures.items()}
            self._run.log({**figures, **shown}, step=step)
        self.remember(self._run.id, step)

    def close(self) -> None:
        with self._troubles_named():
            self._run.finish(_EXIT[self.ended])

    def _troubles_named(self) -> Any:
        return tracker_troubles_named("wandb", wandb.Error, ValueError)  # a setting that there is not
