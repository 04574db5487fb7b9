"""Compiled code is cached wherever possible, and works where nothing can be written."""

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parent.parent
MODULE = "from tb2rl.core.compiled import njit\n@njit(cache=True)\ndef twice(x):\n    return 2 * x\n"
CALLER = "from tiny import twice\n" + MODULE.replace("twice(x)", "call(x)").replace("2 * x", "twice(x)")
USE = """
import tiny
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
    """A function that calls the compiled function as a guest: its result, cache hits, cache folder; warnings."""

    def call(before: str = "", **variables: str) -> tuple[list[str], str]:
        path = os.pathsep.join([str(site), str(CHECKOUT)])
        done = guest.run([sys.executable, "-c", f"import os\n{before}{USE}"], PYTHONPATH=path, **variables)
        assert done.returncode == 0, done.stderr
        assert list(guest.scratch.iterdir()) == [], "the private folder is removed"
        return done.stdout.split(), done.stderr

    return call


@pytest.fixture
def python(site):
    """A function that runs code as this user, and returns its output."""

    def run(code: str, stderr: int | None = None, **variables: str) -> str:
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(CHECKOUT)]), **variables}
        command, pipe = [sys.executable, "-c", code], subprocess.PIPE
        return subprocess.run(command, env=env, check=True, stdout=pipe, stderr=stderr, text=True).stdout

    return run


def test_without_a_writable_folder_a_private_one_is_shared_with_child_processes(site, use, guest):
    guest.lock(site)
    child = f"subprocess.run([sys.executable, '-c', {'import os' + USE!r}])"
    words, warnings = use(before=f"import subprocess, sys\nimport tiny; tiny.twice(4)\n{child}")
    assert words[:2] == ["8", "1"], "the child has the code of its parent"
    assert words[2] == words[5]
    assert Path(words[2]).is_relative_to(guest.scratch)
    assert warnings.count("RuntimeWarning: tb2rl:") == 1
    assert "NUMBA_CACHE_DIR" in warnings


@pytest.mark.slow
@pytest.mark.parametrize("beside", [True, False], ids=["beside it, with a home", "in NUMBA_CACHE_DIR, without one"])
def test_an_earlier_cache_is_used_without_write_permission(beside, site, use, python, guest, tmp_path):
    variables = {} if beside else {"NUMBA_CACHE_DIR": str(tmp_path / "named")}
    python("import tiny; tiny.twice(4)", **variables)
    guest.lock(site)
    if beside:
        variables = {"HOME": str(guest.own(tmp_path / "home"))}
    else:
        guest.lock(tmp_path / "named")
    (result, hits, folder), warnings = use(**variables)
    assert (result, hits, warnings) == ("8", "1", "")
    assert Path(folder).is_relative_to(tmp_path / "home" if beside else guest.scratch)


@pytest.mark.slow
def test_without_even_a_temporary_folder_it_compiles_without_a_cache(site, use, guest):
    guest.lock(site)
    words, warnings = use(before="import tempfile; tempfile.tempdir = '/nonexistent'\n")
    assert words == ["8", "0", "None"]
    assert warnings.count("RuntimeWarning: tb2rl:") == 1


@pytest.mark.slow
def test_a_caller_of_a_function_in_a_changed_file_is_compiled_again(site, python):
    (site / "caller.py").write_text(CALLER)
    code = "import caller; print(caller.call(4), sum(caller.call.stats.cache_hits.values()))"
    assert [python(code), python(code)] == ["8 0\n", "8 1\n"]
    (site / "tiny.py").write_text(MODULE.replace("2 * x", "3 * x"))
    assert python(code) == "12 0\n"


@pytest.mark.slow
def test_compiling_is_announced_once_on_a_terminal(site, python):
    (site / "tinier.py").write_text(MODULE)

    def printed(rest: str) -> str:
        terminal, theirs = os.openpty()
        start = "from tb2rl.core import compiled; compiled.announce_compiling(); import tiny, tinier; tiny.twice(4)"
        python(start + rest, stderr=theirs, NUMBA_CACHE_DIR=str(site / "cache"))
        os.close(theirs)
        with suppress(OSError):  # Linux: nothing was written
            return os.read(terminal, 1000).decode()
        return ""

    assert printed("; tinier.twice(4)").count("compiling") == 1
    assert printed("") == "", "it is cached"
