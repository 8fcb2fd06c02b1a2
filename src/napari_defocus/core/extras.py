"""Packages that come with an extra: whether they are there."""

from importlib.util import find_spec

_PACKAGES_OF_LARGE = ("dask", "filelock", "zarr", "ome_zarr_models")


def need_large_extra() -> None:
    """Raise ImportError, with what to install, if a package of the extra "large" is missing."""
    missing = [name for name in _PACKAGES_OF_LARGE if find_spec(name) is None]
    if missing:
        raise ImportError(
            f"stacks and large pictures need {', '.join(missing)}: "
            "pip install 'napari-defocus[large]'"
        )


def need_matting_extra() -> None:
    """Raise ImportError, with what to install, if PyMatting is missing."""
    if find_spec("pymatting") is None:
        raise ImportError("a soft mask needs pymatting: pip install 'napari-defocus[matting]'")
