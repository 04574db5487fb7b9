"""Runs: configs, run folders, checkpoints, loading of policies.

`folder.py` lists the files of a run folder. This room imports environments and the rooms below them.
"""

from tb2rl.runs.algorithm import make_algorithm, make_baseline, policy_with_normalization, settings_error
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.checkpoint import SUFFIX, is_training_state, read_checkpoint, restore_like, write_checkpoint
from tb2rl.runs.config import Config, TrainSettings, as_preset, config_from, flatten, parse_settings, resolve
from tb2rl.runs.folder import EVALUATION, TRAINING_EVALUATIONS, Run, read_lines, restrict_imports, versions
from tb2rl.runs.loading import HUB, checkpoint_file, config_of, load, load_parameters, parameters_of, policy_digest
