"""Weights & Biases as a tracker; `WANDB_MODE` is "offline" by default, which writes into the run folder."""

import os
from collections.abc import Mapping
from functools import partial
from uuid import uuid4

import numpy as np

from tb2rl.training.trackers import TrackedRun, Tracker, translate_tracker_errors

os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # set first, because wandb reads it on import

import wandb

# Settings that send only metrics and images: no terminal output, code, machine statistics or installed packages.
_PRIVACY_SETTINGS = {
    "silent": True, "console": "off", "disable_git": True, "disable_code": True, "disable_job_creation": True,
    "x_disable_meta": True, "x_disable_stats": True, "x_disable_machine_info": True, "x_save_requirements": False,
}  # fmt: skip
# ValueError is for invalid settings.
_translate = partial(translate_tracker_errors, "wandb", OSError, wandb.Error, ValueError)
_EXIT_CODE = {"finished": 0, "interrupted": 255, "failed": 1}  # Weights & Biases shows 255 as "killed"


class Wandb(Tracker):
    """Writes to one run; offline, each resumed training adds a folder `wandb/offline-run-*` with the same id.

    `WANDB_PROJECT` is the name of the project, by default "tb2rl".
    """

    def __init__(self, training: TrackedRun) -> None:
        super().__init__(training)
        with _translate():
            self._run = wandb.init(
                project=os.environ.get("WANDB_PROJECT") or "tb2rl",
                dir=training.folder,
                id=self.id or uuid4().hex[:8],
                name=training.name,
                config=dict(training.settings),
                resume="allow",
                reinit="create_new",  # because other runs of this process may be active
                settings=wandb.Settings(mode=os.environ.get("WANDB_MODE") or "offline", **_PRIVACY_SETTINGS),
            )
        self.save_run(self._run.id, self._tracked_until)

    @_translate()
    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        images = {key: wandb.Image(picture) for key, picture in pictures.items()}
        self._run.log({**figures, **images}, step=step)
        self.save_run(self._run.id, step)

    @_translate()
    def close(self) -> None:
        self._run.finish(_EXIT_CODE[self.ended])
