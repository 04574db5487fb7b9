"""SDF worlds that the tests write themselves, and how they are read."""

import warnings

import pytest

from tb2rl.core.errors import WorldWarning
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.formats.sdf import VARIABLES
from tb2rl.worlds.registry import read_world


class Sdf:
    """Elements of SDF as text."""

    @staticmethod
    def box(size="1 1 1"):
        return f"<box><size>{size}</size></box>"

    @staticmethod
    def cylinder(radius=0.2, length=1.0):
        return f"<cylinder><radius>{radius}</radius><length>{length}</length></cylinder>"

    @staticmethod
    def collision(shape, pose="0 0 0 0 0 0"):
        return f"<collision name='c'><pose>{pose}</pose><geometry>{shape}</geometry></collision>"

    @staticmethod
    def link(inside, pose="0 0 0 0 0 0"):
        return f"<link name='link'><pose>{pose}</pose>{inside}</link>"

    @staticmethod
    def model(inside, pose="0 0 0 0 0 0", name="m"):
        return f"<model name='{name}'><pose>{pose}</pose>{inside}</model>"

    @classmethod
    def solid(cls, shape, pose="0 0 0 0 0 0", name="m"):
        """A model of one shape."""
        return cls.model(cls.link(cls.collision(shape)), pose, name)


@pytest.fixture
def sdf():
    """The class `Sdf`."""
    return Sdf


@pytest.fixture
def write(tmp_path, monkeypatch):
    """A function that writes a file below the folder of the test, whose models are found through no variable."""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)

    def write_file(name: str, content: str | bytes):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write_file


@pytest.fixture
def read(write):
    """A function that reads a world of SDF: the world, and what it warned about."""

    def read_sdf(inside: str, *, start=(50.0, 50.0, 0.0), name="mine.world", **options):
        path = write(name, f"<sdf version='1.6'><world name='default'>{inside}</world></sdf>")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            world = read_world(path, options=ImportOptions(start=start, **options))
        assert {warning.category for warning in caught} <= {WorldWarning}
        return world, [str(warning.message) for warning in caught]

    return read_sdf
