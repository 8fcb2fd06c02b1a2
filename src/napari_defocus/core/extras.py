"""Packages that come with an extra: whether they are there."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

_PACKAGES_OF_LARGE = ("dask", "filelock", "zarr", "ome_zarr_models")


def is_there(package: str) -> bool:
    """Return whether a package is installed; it is not imported."""
    return find_spec(package) is not None


def need_large_extra() -> None:
    """Raise ImportError, with what to install, if a package of the extra "large" is missing."""
    missing = [name for name in _PACKAGES_OF_LARGE if not is_there(name)]
    if missing:
        raise ImportError(
            f"stacks and large pictures need {', '.join(missing)}: "
            "pip install 'napari-defocus[large]'"
        )


def need_matting_extra() -> None:
    """Raise ImportError, with what to install, if PyMatting is missing."""
    if not is_there("pymatting"):
        raise ImportError("a soft mask needs pymatting: pip install 'napari-defocus[matting]'")


def extra_package(name: str, extra: str, kind: str, otherwise: str) -> Any:
    """Return a package that comes with an extra; ValueError says what needs it, and what to do.

    The message is the end of a sentence, such as "it is a HEIC picture, which needs pip install
    'napari-defocus[heic]'; or save it as PNG first".
    """
    try:
        return import_module(name)
    except ImportError:
        raise ValueError(
            f"it is {kind}, which needs pip install 'napari-defocus[{extra}]'; or {otherwise} first"
        ) from None
