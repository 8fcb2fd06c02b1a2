"""The tests on each Python, with the lowest and the newest versions of everything."""

import time

from release.environments import (
    BUILD,
    StepFailedError,
    build,
    find_python,
    make_environment,
    run_tests,
    tests_without_source,
    uv,
)
from release.requirements import direct_requirements, untested_bounds

PLACES = {
    "lowest-3.11": ("3.11", "lowest-direct"),
    "newest-3.11": ("3.11", "highest"),
    "newest-3.12": ("3.12", "highest"),
    "newest-3.13": ("3.13", "highest"),
}
"""Lowest versions only where they all have wheels: on the oldest Python."""


def check_matrix(arguments):
    """Run the tests in the named places, or all; other arguments go to pytest.

    Returns 0 if they passed in every place that this machine has a Python for.
    """
    chosen = [argument for argument in arguments if argument in PLACES] or list(PLACES)
    for_pytest = [argument for argument in arguments if argument not in PLACES]
    wheel, sdist = build()
    tests = tests_without_source(sdist)
    rows = [(place, *test_in(place, wheel, tests, for_pytest)) for place in chosen]
    print()
    for place, passed, summary in rows:
        print(f"{place:12} {'passed' if passed else 'FAILED':7} {summary}")
    return 0 if all(passed for _, passed, _ in rows) else 1


def test_in(place, wheel, tests, for_pytest):
    """Run the tests in one place; return whether nothing failed, and what is to be said."""
    version, resolution = PLACES[place]
    python = find_python(version)
    if python is None:
        return True, f"not run: this machine has no Python {version}"
    print(f"\n{place}: {python}", flush=True)
    try:
        pinned, objections = compile_versions(place, version, resolution)
        interpreter = make_environment(place, python, wheel, "--requirements", pinned)
    except StepFailedError as failed:
        return False, f"no environment: {failed}"
    start = time.monotonic()
    log = BUILD / "logs" / f"{place}.txt"
    passed, summary = run_tests(interpreter, tests, log, for_pytest)
    print(f"{place}: {time.monotonic() - start:.0f} s, log in {log.relative_to(BUILD.parent)}")
    return passed and not objections, "; ".join([summary, *objections])


def compile_versions(place, version, resolution):
    """Write which version of everything is installed; return the file, and untrue lower bounds."""
    folder = BUILD / "constraints"
    folder.mkdir(parents=True, exist_ok=True)
    wanted, pinned = folder / "direct.in", folder / f"{place}.txt"
    wanted.write_text("\n".join([*direct_requirements(), ""]), encoding="utf-8")
    options = ["--resolution", resolution, "--python-version", version, "--no-header", "--upgrade"]
    uv("pip", "compile", wanted, *options, "--no-annotate", "--output-file", pinned)
    compiled = pinned.read_text(encoding="utf-8")
    lowest = resolution != "highest"
    return pinned, untested_bounds(direct_requirements(), compiled) if lowest else []
