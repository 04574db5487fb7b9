"""Weights & Biases as a tracker: offline, in the run folder, unless `WANDB_MODE` says otherwise."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from uuid import uuid4

import numpy as np

from tb2rl.training.trackers import Tracked, Tracker, translate_tracker_errors

os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # read on import: sends no error reports

import wandb

# Figures only: nothing of the terminal, the code, the machine and its installed packages.
_QUIET = {
    "silent": True, "console": "off", "disable_git": True, "disable_code": True, "disable_job_creation": True,
    "x_disable_meta": True, "x_disable_stats": True, "x_disable_machine_info": True, "x_save_requirements": False,
}  # fmt: skip
_EXIT = {"finished": 0, "interrupted": 255, "failed": 1}  # 255: Weights & Biases calls the run killed


class Wandb(Tracker):
    """Writes a folder `wandb/offline-run-*` for each part of a resumed training, all with the id of one run.

    The project is that of `WANDB_PROJECT`, else "tb2rl".
    """

    def __init__(self, training: Tracked) -> None:
        super().__init__(training)
        with self._translated():
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
        self.remember(self._run.id, self._tracked_until)

    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        with self._translated():
            images = {key: wandb.Image(picture) for key, picture in pictures.items()}
            self._run.log({**figures, **images}, step=step)
        self.remember(self._run.id, step)

    def close(self) -> None:
        with self._translated():
            self._run.finish(_EXIT[self.ended])

    def _translated(self) -> AbstractContextManager[None]:
        return translate_tracker_errors("wandb", wandb.Error, ValueError)  # ValueError: an unknown setting
