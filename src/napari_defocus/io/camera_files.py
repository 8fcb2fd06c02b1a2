"""Pictures as phones and cameras store them, each read by a package that comes with an extra."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.extras import extra_package
from napari_defocus.core.writing import in_one_line


def decode_heic(path: Path) -> NDArray[Any]:
    """Return the main picture of a HEIC file, upright: uint8, or uint16 if it has more bits.

    ValueError says what to install if pillow-heif is missing.
    """
    pillow_heif = extra_package("pillow_heif", "heic", "a HEIC picture", "save it as JPEG or PNG")
    with _decoding("a HEIC picture"):
        picture = pillow_heif.open_heif(path, convert_hdr_to_8bit=False)
        return np.array(picture)  # a view would outlive the pixels, which go with `picture`


def decode_raw(path: Path) -> NDArray[np.uint16]:
    """Return a raw file of a camera, developed in linear light and upright: (H, W, 3) uint16.

    White balance is the camera's; brightness, noise and sharpness stay as they were recorded.
    ValueError says what to install if rawpy is missing.
    """
    rawpy = extra_package("rawpy", "raw", "a raw file of a camera", "develop it to a 16-bit TIFF")
    with _decoding("a raw file of a camera"), rawpy.imread(str(path)) as raw:
        developed: NDArray[np.uint16] = raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, output_bps=16, use_camera_wb=True
        )
    return developed


@contextmanager
def _decoding(kind: str) -> Iterator[None]:
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        told = error.args[0] if error.args else None
        reason = told.decode(errors="replace") if isinstance(told, bytes) else in_one_line(error)
        raise ValueError(f"it is {kind}, which could not be decoded ({reason})") from error
