"""The command line where the machine is not as expected: no compiler, no home, foreign folders."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: 5000 control periods: enough to be compiled
RUN = (
    "run",
    "pi-circle",
    "--json",
    "--set",
    "lap_time=0.5",
    "--set",
    "laps=1",
    "--set",
    "scored=0",
)
MAIN = "from tuning.app.main import main; main()"
#: as in a container that runs under a number that /etc/passwd does not know
NO_USER = """
import pwd
def missing(uid):
    raise KeyError(uid)
pwd.getpwuid = missing
"""


def process(program, tmp_path, **environment):
    """The command line as a program of its own; None removes a variable."""
    own = {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path / "cache")} | environment
    kept = {name: text for name, text in (os.environ | own).items() if text is not None}
    command = [sys.executable, "-c", program, *RUN]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=kept, check=False
    )


def test_a_wrong_compiler_is_one_line_beside_the_result(tmp_path):
    done = process(MAIN, tmp_path, CXX="/no/such -O2")
    assert done.returncode == 0 and json.loads(done.stdout)["finite"]
    reason = "CXX = /no/such -O2: there is no program '/no/such'"
    assert done.stderr == f"jaxstage: runs as a slower lax.scan: {reason}\n"


def test_a_user_without_home_is_one_line_beside_the_result(tmp_path):
    done = process(NO_USER + MAIN, tmp_path, HOME=None, XDG_CACHE_HOME=None)
    assert done.returncode == 0 and json.loads(done.stdout)["finite"]
    reason = "no home folder is known, set HOME or XDG_CACHE_HOME"
    assert done.stderr == f"jaxstage: no cache of compiled programs: {reason}\n"


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="owners and modes are those of POSIX")
def test_a_cache_that_others_may_write_is_one_line_beside_the_result(tmp_path):
    folder = tmp_path / "cache" / "jaxstage"
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    done = process(MAIN, tmp_path)
    assert done.returncode == 0 and json.loads(done.stdout)["finite"]
    reason = f"{folder}: others may write it (mode 777)"
    assert done.stderr == f"jaxstage: no cache of compiled programs: {reason}\n"
    assert not list(folder.iterdir())
