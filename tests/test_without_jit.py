"""The kernels run without numba's compiler too: mistakes that it hides become errors."""

import os
import re
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent


def test_kernels_pass_their_tests_as_plain_python():
    command = [sys.executable, "-m", "pytest", "-m", "kernel", "-p", "no:cacheprovider"]
    # Only the plugin that pyproject.toml has settings for: the others take seconds to start.
    # And only the files that have such tests: importing the others takes seconds, too.
    files = [path for path in TESTS.rglob("test_*.py") if "mark.kernel" in path.read_text("utf-8")]
    command += files
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "NUMBA_NUM_THREADS": "1",  # calls in other threads are not watched
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        "PYTEST_PLUGINS": "pytest_timeout",
    }
    done = subprocess.run(
        command, cwd=TESTS.parent, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed, done.stdout
    assert int(passed[1]) >= 15
