"""Makes the helpers of this folder importable, as `calibration.robots` and so on."""

import sys
from importlib.util import find_spec
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

collect_ignore = [] if find_spec("scipy") and find_spec("rosbags") else ["test_calibration.py"]
