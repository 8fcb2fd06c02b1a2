"""How numba compiles the kernels: the decorators of all of them.

A new machine compiles all kernels of maps before the first map. Somebody waits for that, so a
kernel has no more doors than it needs: numba makes one for Python and one for C. None needs the
latter; what only other kernels call needs neither.

What makes a kernel slow to compile, and is a loop of three lines instead: filling a slice or an
array (``a[:] = b`` brings strings and their formatting along, for an error that cannot occur),
``max`` and ``argmin`` of an array, operations of whole arrays. And a kernel that calls a large
kernel holds all of it once more; Python can call them one after the other.
"""

from numba import njit

compiled = njit(cache=True, error_model="numpy", nogil=True, no_cfunc_wrapper=True)
"""Compile a kernel that Python calls: once a machine, and it runs without the GIL."""

compiled_inline = njit(
    cache=True,
    error_model="numpy",
    nogil=True,
    forceinline=True,
    no_cfunc_wrapper=True,
    no_cpython_wrapper=True,
)
"""Compile what only kernels call: it becomes part of each of them."""
