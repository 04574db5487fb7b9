"""Makes the helpers of this folder importable, as `calibration.robots` and so on."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
