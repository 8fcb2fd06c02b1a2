"""The checks before a release: `nox -t package`, `nox -s matrix`; docs/releasing.md tells of them.

`python3 tasks.py nox ...` installs nox, uv and the system packages of Qt first.
"""

import os
import shutil
import tarfile
from pathlib import Path

import nox

nox.needs_version = ">=2026.10"
nox.options.default_venv_backend = "uv"
nox.options.download_python = "never"
nox.options.envdir = "build/nox"
nox.options.tags = ["package"]

# What is installed is checked, not the source tree.
os.environ.pop("PYTHONPATH", None)

ROOT = Path(__file__).parent
DISTRIBUTIONS = ROOT / "build" / "distributions"
EXTRAS = "napari", "large", "heic", "raw", "microscopes", "slides", "matting"
PYTHONS = nox.project.python_versions(nox.project.load_toml(ROOT / "pyproject.toml"))

LARGEST = {".whl": 1_500_000, ".gz": 2_500_000}
"""Bytes; the bundled photographs are half a megabyte."""


@nox.session(tags=["package"])
def build(session):
    """Build the source distribution, and the wheel from it, and look into both."""
    shutil.rmtree(DISTRIBUTIONS, ignore_errors=True)
    session.run("uv", "build", "--quiet", "--out-dir", DISTRIBUTIONS, ROOT)
    session.install("check-wheel-contents", "twine")
    # Every file of the package and nothing else.
    session.run("check-wheel-contents", wheel())
    # The metadata, and what the package index shows.
    session.run("twine", "check", "--strict", wheel(), sdist())
    for path in (wheel(), sdist()):
        size, largest = path.stat().st_size, LARGEST[path.suffix]
        session.log(f"{path.name}: {size / 1e6:.2f} MB")
        if size > largest:
            session.error(f"{path.name} has {size} bytes, {largest} are allowed")


@nox.session(tags=["package"], requires=["build"])
@nox.parametrize("extra", ["none", "napari", "large"], ids=["none", "napari", "large"])
def extra(session, extra):
    """Install the wheel with one of its extras, or with none, and use it from an empty folder."""
    session.install(f"{wheel()}[{extra}]" if extra != "none" else wheel())
    session.chdir(empty_folder(session))
    session.run("python", ROOT / "release" / "use_installed.py", extra)


@nox.session(tags=["package"], requires=["build"])
def types(session):
    """Let two type checkers look at a user's script and at the public names."""
    session.install(wheel(), "mypy", "basedpyright")
    session.chdir(empty_folder(session))
    session.run("mypy", "--strict", ROOT / "release" / "user_script.py")
    session.run("python", ROOT / "release" / "annotations.py")


@nox.session(tags=["package"], requires=["build"])
def tests(session):
    """Run the tests where only the wheel is installed."""
    session.install(f"{wheel()}[{','.join(EXTRAS)}]", "--group", "test")
    run_tests(session)


@nox.session(requires=["build"])
@nox.parametrize(
    ("python", "resolution"),
    [
        # Lowest versions only where they all have wheels: on the oldest Python.
        nox.param(PYTHONS[0], "lowest-direct", id=f"lowest-{PYTHONS[0]}"),
        *(nox.param(version, "highest", id=f"newest-{version}") for version in PYTHONS),
    ],
)
def matrix(session, resolution):
    """Run the tests on each Python, with the lowest and the newest versions of everything."""
    # pyproject.toml beside the wheel, so that what the package asks for counts as direct.
    asked = ["--requirements", "pyproject.toml"]
    for extra in EXTRAS:
        asked += ["--extra", extra]
    session.install(wheel(), *asked, "--group", "test", "--resolution", resolution)
    if resolution == "lowest-direct":
        session.run("python", ROOT / "release" / "lower_bounds.py")
    run_tests(session)


def run_tests(session):
    """Run the tests of the source distribution, from which the package itself is taken away."""
    folder = empty_folder(session)
    with tarfile.open(sdist()) as archive:
        archive.extractall(folder, filter="data")
    [top] = folder.iterdir()
    shutil.rmtree(top / "src")
    session.chdir(top)
    shared = "-n", "2", "--dist", "loadscope", "--no-loadscope-reorder"
    session.run("pytest", *shared, *session.posargs)


def wheel():
    [path] = DISTRIBUTIONS.glob("*.whl")
    return path


def sdist():
    [path] = DISTRIBUTIONS.glob("*.tar.gz")
    return path


def empty_folder(session):
    folder = Path(session.create_tmp(), "empty")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder
