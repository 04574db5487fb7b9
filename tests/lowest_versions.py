"""Print the lowest versions that pyproject.toml allows, except of torch, as constraints for pip."""

import tomllib
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = tomllib.loads(Path(__file__).parent.parent.joinpath("pyproject.toml").read_text(encoding="utf-8"))["project"]
EXCEPTED = {"torch"}  # old releases have no CPU build on the package index

extras = {name: group for name, group in PROJECT["optional-dependencies"].items() if name != "dev"}
groups = [PROJECT["dependencies"], *extras.values()]
for requirement in (Requirement(each) for group in groups for each in group):
    for bound in requirement.specifier:
        if bound.operator == ">=" and requirement.name not in EXCEPTED:
            print(f"{requirement.name}=={bound.version}")
