import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize(
    ("example", "says"),
    [
        ("plain_functions.py", ["noise variance found", "mean error", "in focus"]),
        (
            "headless_session.py",
            [
                "simulated ramp blur (px): (300, 300), scale [0.65 0.65]",
                "noise variance",
                "in focus",
            ],
        ),
    ],
)
def test_example_runs_and_prints_its_numbers(example, says):
    done = subprocess.run([sys.executable, str(EXAMPLES / example)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for words in says:
        assert words in done.stdout


def test_every_example_is_run():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {
        "plain_functions.py",
        "headless_session.py",
    }
