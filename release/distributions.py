"""What a wheel and a source distribution have to hold, and what must not be in them."""

import tarfile
import zipfile
from email import message_from_bytes
from pathlib import Path, PurePosixPath

PACKAGE = "napari_defocus"
LARGEST_FILE = 500_000
LARGEST_WHEEL = 1_500_000
LARGEST_SDIST = 2_500_000
"""Bytes; the bundled photographs are half a megabyte."""

NEEDED_FILES = (
    "napari.yaml",
    "py.typed",
    "samples/ATTRIBUTION.md",
    "samples/brushes.jpg",
    "samples/dandelion.jpg",
    "widgets/__init__.py",
)
ENTRY_POINTS = (
    "napari-defocus = napari_defocus.cli.app:main",
    "napari-defocus = napari_defocus:napari.yaml",
)
NEEDED_IN_SDIST = (
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "LICENSE",
    "README.md",
    "docs/guide.md",
    "examples/plain_functions.py",
    "pyproject.toml",
    "tasks.py",
    "tests/conftest.py",
    "tests/widgets/conftest.py",
)
PARTS_OF_SDIST = {
    *(".ci", "benchmarks", "docs", "examples", "release", "src", "tests"),
    *(".gitignore", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "PKG-INFO"),
    *("README.md", "napari.yaml", "pyproject.toml", "tasks.py"),
}


def objections_to_wheel(path, version, source):
    """Return what is wrong with a wheel of this version and source folder: a list of lines."""
    with zipfile.ZipFile(path) as archive:
        sizes = {entry.filename: entry.file_size for entry in archive.infolist()}
        information = f"{PACKAGE}-{version}.dist-info"
        if f"{information}/METADATA" not in sizes:
            return [f"{path.name} holds no {information}/METADATA"]
        metadata = message_from_bytes(archive.read(f"{information}/METADATA"))
        entry_points = archive.read(f"{information}/entry_points.txt").decode()
    return [
        *_too_large(path, sizes, LARGEST_WHEEL),
        *_missing(sizes, [f"{PACKAGE}/{name}" for name in [*NEEDED_FILES, *_modules(source)]]),
        *_missing(sizes, _licence_files(metadata, information)),
        *(f"not expected: {name}" for name in sizes if not _belongs(name, information)),
        *(f"no entry point {line!r}" for line in ENTRY_POINTS if line not in entry_points),
        *_objections_to_metadata(metadata, version),
    ]


def objections_to_sdist(path, version):
    """Return what is wrong with a source distribution: a list of lines."""
    with tarfile.open(path) as archive:
        members = archive.getmembers()
    prefix = f"{PACKAGE}-{version}/"
    sizes = {member.name.removeprefix(prefix): member.size for member in members}
    tops = {name.partition("/")[0] for name in sizes}
    return [
        *_too_large(path, sizes, LARGEST_SDIST),
        *_missing(sizes, NEEDED_IN_SDIST),
        *(f"not expected: {name}" for name in sorted(tops - PARTS_OF_SDIST)),
    ]


def _too_large(path, sizes, largest):
    whole = path.stat().st_size
    if whole > largest:
        yield f"{path.name} has {whole} bytes, {largest} are allowed"
    for name, size in sizes.items():
        if size > LARGEST_FILE:
            yield f"{name} has {size} bytes, {LARGEST_FILE} are allowed"


def _missing(sizes, names):
    return [f"missing: {name}" for name in names if name not in sizes]


def _modules(source):
    return [path.relative_to(source).as_posix() for path in Path(source).rglob("*.py")]


def _licence_files(metadata, information):
    named = metadata.get_all("License-File") or ["LICENSE"]
    return [f"{information}/licenses/{name}" for name in named]


def _belongs(name, information):
    path = PurePosixPath(name)
    return (
        path.parts[0] in {PACKAGE, information}
        and not {"tests", "__pycache__"} & set(path.parts)
        and path.suffix not in {".pyc", ".nbi", ".nbc"}
    )


def _objections_to_metadata(metadata, version):
    expected = {
        "Name": "napari-defocus",
        "Version": version,
        "License-Expression": "GPL-3.0-or-later",
        "Requires-Python": ">=3.11",
    }
    for name, value in expected.items():
        if metadata[name] != value:
            yield f"the metadata say {name}: {metadata[name]}, not {value}"
    if len(metadata.get_all("License-File") or []) < 2:
        yield "the licences of the package and of its pictures are not both named"
