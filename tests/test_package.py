"""What a release promises: versions, lower bounds, and what the wheel and the sdist may hold."""

import io
import re
import tarfile
import tomllib
import zipfile
from importlib.metadata import requires
from pathlib import Path

import pytest

import napari_defocus
from release.distributions import (
    ENTRY_POINTS,
    NEEDED_FILES,
    NEEDED_IN_SDIST,
    PARTS_OF_SDIST,
    objections_to_sdist,
    objections_to_wheel,
)
from release.matrix import PLACES
from release.requirements import direct_requirements, lower_bounds, untested_bounds

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
VERSION = napari_defocus.__version__
INFORMATION = f"napari_defocus-{VERSION}.dist-info"
LICENCES = "LICENSE", "src/napari_defocus/samples/ATTRIBUTION.md"


def test_changelog_and_citation_are_about_this_version():
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    cited = re.search(r"^version: (\S+)", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert newest[1] == cited[1] == VERSION


def test_every_dependency_says_which_version_is_the_lowest():
    assert [name for name, bound in lower_bounds(direct_requirements()).items() if not bound] == []


def test_nothing_of_napari_or_of_qt_is_needed_by_the_package_itself():
    needed = [line for line in requires("napari-defocus") if "extra ==" not in line]
    assert needed
    assert not [
        line for line in needed if re.match(r"napari|magicgui|qtpy|superqt|PySide|PyQt", line)
    ]


def test_the_tests_run_on_every_python_that_the_package_claims():
    claimed = [
        line.rpartition(" ")[2]
        for line in PYPROJECT["project"]["classifiers"]
        if re.search(r":: 3\.\d+$", line)
    ]
    assert PYPROJECT["project"]["requires-python"] == f">={claimed[0]}"
    assert sorted({version for version, _ in PLACES.values()}) == claimed
    assert PLACES[f"lowest-{claimed[0]}"] == (claimed[0], "lowest-direct")


@pytest.mark.parametrize(
    ("resolved", "raised"),
    [("1.14.0", []), ("1.14.1", []), ("1.15.0", ["scipy"]), ("1.1", ["scipy"])],
)
def test_lower_bound_that_is_never_met_is_noticed(resolved, raised):
    found = untested_bounds(["scipy>=1.14", "rich"], f"scipy=={resolved}\nrich==14.0.0\n")
    assert [line.partition(">")[0] for line in found] == raised


@pytest.fixture
def source(tmp_path):
    folder = tmp_path / "src" / "napari_defocus"
    folder.mkdir(parents=True)
    for name in ("__init__.py", "cli.py"):
        (folder / name).touch()
    return folder


@pytest.fixture
def good_wheel():
    metadata = [
        f"Metadata-Version: 2.4\nName: napari-defocus\nVersion: {VERSION}",
        "License-Expression: GPL-3.0-or-later\nRequires-Python: >=3.11",
        *(f"License-File: {name}" for name in LICENCES),
    ]
    return {
        **{f"napari_defocus/{name}": "" for name in [*NEEDED_FILES, "__init__.py", "cli.py"]},
        f"{INFORMATION}/METADATA": "\n".join(metadata),
        f"{INFORMATION}/entry_points.txt": "\n".join(ENTRY_POINTS),
        **{f"{INFORMATION}/licenses/{name}": "" for name in LICENCES},
    }


@pytest.fixture
def objections(tmp_path, source):
    def to(files):
        path = tmp_path / f"napari_defocus-{VERSION}-py3-none-any.whl"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                archive.writestr(name, content)
        return objections_to_wheel(path, VERSION, source)

    return to


def test_good_wheel_is_accepted(objections, good_wheel):
    assert objections(good_wheel) == []


@pytest.mark.parametrize(
    "name",
    [
        *("napari_defocus/napari.yaml", "napari_defocus/py.typed", "napari_defocus/cli.py"),
        "napari_defocus/samples/dandelion.jpg",
        f"{INFORMATION}/licenses/LICENSE",
        f"{INFORMATION}/METADATA",
    ],
)
def test_wheel_that_lacks_a_file_is_refused(objections, good_wheel, name):
    del good_wheel[name]
    [said] = objections(good_wheel)
    assert name in said


@pytest.mark.parametrize(
    "name",
    ["tests/test_api.py", "napari_defocus/tests/test_api.py", "napari_defocus/psf.nbi", "tasks.py"],
)
def test_wheel_that_holds_what_does_not_belong_there_is_refused(objections, good_wheel, name):
    assert objections(good_wheel | {name: ""}) == [f"not expected: {name}"]


def test_wheel_with_a_large_file_is_refused(objections, good_wheel):
    [said] = objections(good_wheel | {"napari_defocus/samples/slide.tif": bytes(500_001)})
    assert said == "napari_defocus/samples/slide.tif has 500001 bytes, 500000 are allowed"


@pytest.mark.parametrize(
    ("line", "other", "says"),
    [
        (f"Version: {VERSION}", "Version: 0.0.1", f"Version: 0.0.1, not {VERSION}"),
        ("GPL-3.0-or-later", "MIT", "License-Expression: MIT"),
        (">=3.11", ">=3.8", "Requires-Python: >=3.8"),
    ],
)
def test_wheel_with_other_metadata_is_refused(objections, good_wheel, line, other, says):
    name = f"{INFORMATION}/METADATA"
    [said] = objections(good_wheel | {name: good_wheel[name].replace(line, other)})
    assert says in said


def test_wheel_that_napari_would_not_find_is_refused(objections, good_wheel):
    found = objections(good_wheel | {f"{INFORMATION}/entry_points.txt": ENTRY_POINTS[0]})
    assert found == ["no entry point 'napari-defocus = napari_defocus:napari.yaml'"]


def test_sdist_with_what_lay_beside_the_code_is_refused(tmp_path):
    path = tmp_path / f"napari_defocus-{VERSION}.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        for name in [*NEEDED_IN_SDIST, "scratch/notes.txt"]:
            archive.addfile(tarfile.TarInfo(f"napari_defocus-{VERSION}/{name}"), io.BytesIO())
    assert objections_to_sdist(path, VERSION) == ["not expected: scratch"]


def test_all_that_is_needed_goes_into_the_sdist():
    table = PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]
    named = {name.partition("/")[0] for name in table["only-include"]}
    added_by_hatchling = {".gitignore", "LICENSE", "PKG-INFO", "README.md", "pyproject.toml"}
    assert named | added_by_hatchling == PARTS_OF_SDIST
    # The package itself, and the link into it, are not there where only the wheel is tested.
    own = {"src/napari_defocus", "napari.yaml"}
    assert not [
        name for name in table["only-include"] if not (own & {name} or (ROOT / name).exists())
    ]
