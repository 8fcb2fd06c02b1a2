"""Build the wheel and the source distribution, look into them, install them, use and test them."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from release.distributions import objections_to_sdist, objections_to_wheel
from release.environments import (
    BUILD,
    ROOT,
    StepFailedError,
    build,
    clean,
    make_environment,
    program,
    run,
    run_tests,
    tests_without_source,
)
from release.requirements import direct_requirements

SOURCE = ROOT / "src" / "napari_defocus"

INSTALLED = """
import sys
from importlib.metadata import version
from pathlib import Path
import napari_defocus
assert Path(sys.prefix) in Path(napari_defocus.__file__).parents, napari_defocus.__file__
assert version("napari-defocus") == napari_defocus.__version__
for name in napari_defocus.__all__:
    getattr(napari_defocus, name)
assert not {"napari", "qtpy", "dask"} & set(sys.modules)
"""

WITHOUT_EXTRAS = """
from importlib.util import find_spec
assert not any(map(find_spec, ["napari", "qtpy", "magicgui", "dask", "zarr"]))
"""

WITH_NAPARI = """
from napari.components import ViewerModel
from npe2 import PluginManager
viewer = ViewerModel()
PluginManager.instance().discover()
assert "napari-defocus" in PluginManager.instance()
[layer] = viewer.open_sample("napari-defocus", "dandelion")
print("sample opened through the manifest:", layer)
"""

WITH_LARGE = """
import dask.array
import numpy as np
from napari_defocus import estimate_blur_map
picture = np.random.default_rng(0).uniform(size=(96, 96)).astype(np.float32)
lazy = estimate_blur_map(dask.array.from_array(picture, chunks=64))
assert np.isfinite(lazy.compute(scheduler="sync")).all()
print("map of a dask array:", lazy)
"""


def check_package(arguments):
    """Do it all; return 0 if nothing is to be said against the package."""
    wheel, sdist = build()
    version = wheel.name.split("-")[1]
    objections = [
        *objections_to_wheel(wheel, version, SOURCE),
        *objections_to_sdist(sdist, version),
    ]
    for path in (wheel, sdist):
        print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")
    try:
        objections += use_installed(wheel)
    except StepFailedError as failed:
        objections.append(f"failed: {failed}")
    passed, summary = test_installed(wheel, sdist, arguments)
    print("\nwheel and sdist:", *(objections or ["nothing to object to"]), sep="\n  ")
    print("tests against the installed wheel:", summary)
    return 0 if passed and not objections else 1


def use_installed(wheel):
    """Use what is installed with and without extras, from an empty folder; return objections."""
    bare = make_environment("bare", sys.executable, wheel)
    extras = {
        "with-napari": (f"{wheel}[napari]", INSTALLED + WITH_NAPARI),
        "with-large": (f"{wheel}[large]", INSTALLED + WITH_LARGE),
    }
    with tempfile.TemporaryDirectory() as empty:
        run(bare, "-c", INSTALLED + WITHOUT_EXTRAS, cwd=empty)
        use_terminal(bare, Path(empty))
        objections = check_types(bare, empty)
        for name, (package, code) in extras.items():
            run(make_environment(name, sys.executable, package), "-c", code, cwd=empty)
    return objections


def use_terminal(python, folder):
    """Measure a picture with the terminal command."""
    command = program(python, "napari-defocus")
    run(command, "--version", cwd=folder)
    run(command, "sample", "brushes.jpg", "--name", "brushes", cwd=folder)
    run(command, "map", "brushes.jpg", "--stride", "8", cwd=folder)
    if not {"brushes-blur.tif", "brushes-blur.png"} <= {path.name for path in folder.iterdir()}:
        raise StepFailedError("napari-defocus map wrote no map")


def check_types(python, folder):
    """Let mypy and a second type checker look at the installed package; return objections."""
    mypy = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", BUILD / "mypy"]
    run(*mypy, "--python-executable", python, ROOT / "release" / "user_script.py", cwd=folder)
    unknown = untyped_symbols(python, folder)
    print(f"public names that are not fully annotated: {len(unknown)}")
    return [f"not fully annotated: {name}" for name in unknown]


def untyped_symbols(python, folder):
    """Return what is not fully annotated of the public names and the modules that hold them."""
    search = clean(VIRTUAL_ENV=str(python.parents[1]))
    search["PATH"] = os.pathsep.join([str(python.parent), search["PATH"]])
    checker = program(Path(sys.executable), "basedpyright")
    options = ["--verifytypes", "napari_defocus", "--ignoreexternal", "--outputjson"]
    answer = subprocess.run(
        [checker, *options], cwd=folder, env=search, capture_output=True, text=True
    )
    symbols = json.loads(answer.stdout)["typeCompleteness"]["symbols"]
    if not any(symbol["isExported"] for symbol in symbols):
        raise StepFailedError("the type checker found no public name")
    homes = public_modules(python)
    return [
        symbol["name"]
        for symbol in symbols
        if not symbol["isTypeKnown"] and symbol["name"].split(".")[1] in homes
    ]


def public_modules(python):
    """Return the modules that public names come from, and the names themselves."""
    code = "import napari_defocus as d; print(*d.__all__, *d._HOME_OF.values())"
    return set(subprocess.check_output([python, "-c", code], env=clean(), text=True).split())


def test_installed(wheel, sdist, arguments):
    """Run the tests where only the wheel is; return whether they passed, and a summary."""
    python = make_environment("tests", sys.executable, wheel, *direct_requirements())
    return run_tests(python, tests_without_source(sdist), BUILD / "logs" / "package.txt", arguments)
