"""How far results differ between processors: this one, made to act as others.

    python benchmarks/processors.py

Measures one picture in a process each with other kernels of OpenBLAS, other code of numba and of
NumPy, and other functions of the C library, and prints the largest differences from this
processor's own results. What is promised to be the same is tested in tests/test_same_bits.py.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

MEASURE = """
import sys
import numpy as np
from skimage.data import chelsea
from napari_defocus import *

picture = chelsea()
candidates = estimate_candidates(picture)
blur_map = label_blur_map(candidates, picture)
np.savez(
    sys.argv[1], candidates=np.nan_to_num(candidates.radii), map=blur_map,
    confidence=confidence_map(candidates, blur_map), mask=segment_in_focus(candidates, picture),
)
"""

PROCESSORS = {
    "OpenBLAS: Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
    "OpenBLAS: Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "one thread": {"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    "numba: Haswell": {"NUMBA_CPU_NAME": "haswell"},
    "numba: Nehalem": {"NUMBA_CPU_NAME": "nehalem"},
    "NumPy: no AVX-512": {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL"},
    "NumPy: no AVX2": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"},
    "glibc: no FMA": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F"},
}


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        here = results(Path(folder), "here", {})
        print(f"| {'':18} | " + " | ".join(f"{name:>10}" for name in here) + " |")
        print("|---" * (len(here) + 1) + "|")
        for name, environment in PROCESSORS.items():
            there = results(Path(folder), name, environment)
            differences = (np.abs(there[key].astype(float) - here[key]).max() for key in here)
            print(f"| {name:18} | " + " | ".join(f"{d:10.2g}" for d in differences) + " |")


def results(folder: Path, name: str, environment: dict[str, str]) -> dict[str, np.ndarray]:
    """Return what a process finds; kernels for another processor are not kept."""
    path = folder / f"{len(list(folder.iterdir()))}.npz"
    if "NUMBA_CPU_NAME" in environment:
        environment = environment | {"NUMBA_CACHE_DIR": str(folder / "kernels")}
    command = [sys.executable, "-c", MEASURE, str(path)]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{name}: {done.stderr.strip().splitlines()[-1]}")
    with np.load(path) as found:
        return dict(found)


if __name__ == "__main__":
    main()
