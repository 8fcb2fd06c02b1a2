"""What pyproject.toml asks for, and whether its lower bounds are the versions that are tested."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = "napari", "large"

_BOUND = re.compile(r"(?P<name>[A-Za-z0-9._-]+)(\[[^\]]*\])?>=(?P<version>[0-9.]+)")
_PIN = re.compile(r"(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^ ;]+)")


def direct_requirements(folder=ROOT):
    """Return what the package, its extras and its tests ask for: a list of PEP 508 strings.

    The package itself, which its own extras and groups name, is left out: a resolver that has
    to find the lowest versions would look for a published one.
    """
    content = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))
    project = content["project"]
    lists = [
        project["dependencies"],
        *(project["optional-dependencies"][extra] for extra in EXTRAS),
        content["dependency-groups"]["test"],
    ]
    found = [requirement for one in lists for requirement in one]
    return [one for one in found if not one.startswith(project["name"])]


def lower_bounds(requirements):
    """Return {name: lowest version} of PEP 508 strings; a version of None where none is said."""
    bounds = {}
    for requirement in requirements:
        match = _BOUND.match(requirement)
        name = match["name"] if match else re.split(r"[^A-Za-z0-9._-]", requirement)[0]
        bounds[_normalized(name)] = match["version"] if match else None
    return bounds


def pins(compiled):
    """Return {name: version} of a compiled list, lines such as "numpy==2.0.0"."""
    matches = filter(None, map(_PIN.match, compiled.splitlines()))
    return {_normalized(match["name"]): match["version"] for match in matches}


def untested_bounds(requirements, compiled):
    """Return a line for each lower bound below the lowest version that can be had.

    Other packages may ask for newer ones than we do. A bound that no test ever meets is a promise
    that nobody keeps: it is raised to what is tested.
    """
    lowest = pins(compiled)
    return [
        f"{name}>={bound} is not tested: the lowest version to be had is {lowest[name]}"
        for name, bound in lower_bounds(requirements).items()
        if bound is not None and not _begins(lowest[name], bound)
    ]


def _begins(version, bound):
    """Tell whether 1.14.0 is the lowest of 1.14: yes, of 1.1: no."""
    parts = bound.split(".")
    return version.split(".")[: len(parts)] == parts


def _normalized(name):
    return re.sub(r"[-_.]+", "-", name).lower()
