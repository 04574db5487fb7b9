"""What is compiled is cached wherever it can be, and works where nothing can be written."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parent.parent
MODULE = """
from tb2rl.core.compiled import njit

@njit(cache=True)
def twice(x):
    return 2 * x
"""
CALLER = """
from tb2rl.core.compiled import njit
from tiny import twice

@njit(cache=True)
def call(x):
    return twice(x)
"""
USE = """
import numba, tiny
assert numba.config.CACHE_DIR == os.environ.get("NUMBA_CACHE_DIR", ""), "numba's own settings are left alone"
print(tiny.twice(4), sum(tiny.twice.stats.cache_hits.values()), tiny.twice.stats.cache_path)
"""


@pytest.fixture
def site(tmp_path):
    """A folder with a module that compiles a function."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "tiny.py").write_text(MODULE)
    return folder


@pytest.fixture
def use(site, guest):
    """A function that calls the compiled function as a guest: its result, hits in the cache, its folder; warnings."""

    def call(before: str = "", **variables: str) -> tuple[list[str], str]:
        path = os.pathsep.join([str(site), str(CHECKOUT)])
        done = guest.run([sys.executable, "-c", f"import os\n{before}{USE}"], PYTHONPATH=path, **variables)
        assert done.returncode == 0, done.stderr
        assert list(guest.scratch.iterdir()) == [], "the private folder is gone"
        return done.stdout.split(), done.stderr

    return call


def warm(site, **variables):
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(CHECKOUT)]), **variables}
    subprocess.run([sys.executable, "-c", "import tiny; tiny.twice(4)"], env=env, check=True)


def test_without_any_cache_it_works_and_one_warning_says_what_to_set(site, use, guest):
    guest.lock(site)
    (result, hits, folder), warnings = use()
    assert (result, hits) == ("8", "0")
    assert Path(folder).is_relative_to(guest.scratch)
    assert warnings.count("RuntimeWarning: tb2rl:") == 1
    assert "NUMBA_CACHE_DIR" in warnings


def test_processes_that_it_starts_share_the_private_folder_in_silence(site, use, guest):
    guest.lock(site)
    another = f"subprocess.run([sys.executable, '-c', {'import os' + USE!r}])"
    start = f"import subprocess, sys\nimport tiny; tiny.twice(4)\n{another}"
    words, warnings = use(before=start)
    assert words[:2] == ["8", "1"], "the second process has what the first one compiled"
    assert words[2] == words[5]
    assert warnings.count("RuntimeWarning: tb2rl:") == 1


@pytest.mark.parametrize(("beside", "home"), [(True, True), (False, False)], ids=["beside it", "in NUMBA_CACHE_DIR"])
def test_what_was_compiled_earlier_is_used_though_it_cannot_be_written(beside, home, site, use, guest, tmp_path):
    named = {} if beside else {"NUMBA_CACHE_DIR": str(tmp_path / "named")}
    warm(site, **named)
    for folder in (site, tmp_path / "named"):
        if folder.exists():
            guest.lock(folder)
    variables = {**named, **({"HOME": str(guest.own(tmp_path / "home"))} if home else {})}
    (result, hits, folder), warnings = use(**variables)
    assert (result, hits, warnings) == ("8", "1", "")
    assert Path(folder).is_relative_to(tmp_path / "home" if home else guest.scratch)


def test_where_not_even_a_temporary_folder_can_be_it_compiles_without_a_cache(site, use, guest):
    guest.lock(site)
    (result, hits, folder), warnings = use(before="import tempfile; tempfile.tempdir = '/nonexistent'\n")
    assert (result, hits, folder) == ("8", "0", "None")
    assert warnings.count("RuntimeWarning: tb2rl:") == 1


def test_a_folder_that_others_may_write_to_is_not_trusted(site, use, guest, tmp_path):
    guest.lock(site)
    open_to_all = guest.own(tmp_path / "open")
    open_to_all.chmod(0o777)
    (_, _, folder), _ = use(TB2RL_PRIVATE_CACHE=str(open_to_all))
    assert Path(folder).is_relative_to(guest.scratch)


def test_what_calls_a_function_of_a_changed_file_is_compiled_again(site):
    (site / "caller.py").write_text(CALLER)
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(CHECKOUT)])}
    use = "import caller; print(caller.call(4), sum(caller.call.stats.cache_hits.values()))"

    def run():
        return subprocess.run([sys.executable, "-c", use], env=env, check=True, capture_output=True, text=True).stdout

    assert [run(), run()] == ["8 0\n", "8 1\n"]
    (site / "tiny.py").write_text(MODULE.replace("2 * x", "3 * x"))
    assert run() == "12 0\n"


def test_what_is_compiled_is_said_once_on_a_terminal(site, tmp_path):
    (site / "tinier.py").write_text(MODULE)
    program = "from tb2rl.core import compiled; compiled.announce_compiling(); import tiny, tinier; tiny.twice(4)"
    path = os.pathsep.join([str(site), str(CHECKOUT)])
    env = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def said(rest: str) -> str:
        terminal, theirs = os.openpty()
        subprocess.run([sys.executable, "-c", program + rest], env=env, stderr=theirs, check=True)
        os.close(theirs)
        with suppress(OSError):  # Linux: nothing was written, and nobody will
            return os.read(terminal, 1000).decode()
        return ""

    assert said("; tinier.twice(4)").count("compiling") == 1
    assert said("") == "", "it is in the cache"
