"""What a release promises: versions, lower bounds, and what goes into the sdist."""

import re
import tomllib
from importlib.metadata import requires
from pathlib import Path

import pytest

import napari_defocus
from release.lower_bounds import direct_requirements, lower_bound, untested_bounds

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
VERSION = napari_defocus.__version__


def test_changelog_and_citation_are_about_this_version():
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    cited = re.search(r"^version: (\S+)", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert newest[1] == cited[1] == VERSION


def test_every_dependency_says_which_version_is_the_lowest():
    assert direct_requirements()
    assert [line for line in direct_requirements() if not lower_bound(line)] == []


def test_nothing_of_napari_or_of_qt_is_needed_by_the_package_itself():
    needed = [line for line in requires("napari-defocus") if "extra ==" not in line]
    assert needed
    assert not [
        line for line in needed if re.match(r"napari|magicgui|qtpy|superqt|PySide|PyQt", line)
    ]


def test_the_oldest_python_that_is_tested_is_the_oldest_that_is_taken():
    # noxfile.py runs the tests on each Python of the classifiers.
    claimed = [
        line.rpartition(" ")[2]
        for line in PYPROJECT["project"]["classifiers"]
        if re.search(r":: 3\.\d+$", line)
    ]
    assert PYPROJECT["project"]["requires-python"] == f">={claimed[0]}"


@pytest.mark.parametrize(
    ("bound", "installed", "is_tested"),
    [
        ("1.14", "1.14.0", True),
        ("1.14", "1.14.1", True),
        ("1.14", "1.15.0", False),
        ("1.14", "1.1", False),
        ("2024.9", "2024.9.22", True),
        ("0.1.7.post5", "0.1.7.post5", True),
    ],
)
def test_lower_bound_that_is_never_met_is_noticed(bound, installed, is_tested):
    said = untested_bounds([f"scipy>={bound}", "rich"], {"scipy": installed}.__getitem__)
    assert [line.partition(" ")[0] for line in said] == ([] if is_tested else [f"scipy>={bound}"])


def test_lower_bound_of_another_system_is_not_looked_at():
    elsewhere = 'pywin32>=300; sys_platform == "none"'
    assert untested_bounds([elsewhere], {}.__getitem__) == []


def test_all_that_is_named_for_the_sdist_is_there():
    named = PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["only-include"]
    # The package itself, and the link into it, are not there where only the wheel is tested.
    own = {"src/napari_defocus", "napari.yaml"}
    assert not [name for name in named if not (own & {name} or (ROOT / name).exists())]
