"""Fail if a lower bound of pyproject.toml is not the version that is installed here.

Other packages may ask for newer ones than we do. A bound that no test ever meets is a promise that
nobody keeps: it is raised to what is tested.
"""

import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[1]
EXTRAS = "napari", "large", "heic", "raw"


def direct_requirements():
    """Return what the package, its extras and its tests ask for: a list of PEP 508 strings."""
    content = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = content["project"]
    of_extras = [line for extra in EXTRAS for line in project["optional-dependencies"][extra]]
    return [*project["dependencies"], *of_extras, *content["dependency-groups"]["test"]]


def lower_bound(requirement):
    """Return the version after ">=" in a PEP 508 string, None where none is said."""
    bounds = [each for each in Requirement(requirement).specifier if each.operator == ">="]
    return Version(bounds[0].version) if bounds else None


def untested_bounds(requirements, version_of=version):
    """Return a line for each lower bound that is not the version of `version_of(name)`."""
    found = []
    for requirement in requirements:
        name, bound = Requirement(requirement).name, lower_bound(requirement)
        if bound is None or not applies(requirement):
            continue
        tested = Version(version_of(name))
        # 1.14.1 will do for 1.14: some first releases have no wheel.
        if tested < bound or tested.release[: len(bound.release)] != bound.release:
            found.append(f"{name}>={bound} is not tested: the lowest version to be had is {tested}")
    return found


def applies(requirement):
    marker = Requirement(requirement).marker
    return marker is None or marker.evaluate()


if __name__ == "__main__":
    sys.exit("\n".join(untested_bounds(direct_requirements())) or 0)
