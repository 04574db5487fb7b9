"""tb2rl"""
from pathlib import Path as _Path

# In a checkout, agents/, configs/ and zoo/ stand beside this package; an installed package contains them.
_checkout = _Path(__file__).parent.parent
if (_checkout / "pyproject.toml").is_file():
    __path__.append(str(_checkout))
