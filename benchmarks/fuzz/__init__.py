"""Random calls of every public function and of the terminal command: what is not right or clear.

Each module of recipes adds its own to `call.RECIPES` when it is imported.
"""

from benchmarks.fuzz import files, lenses, maps, pictures  # noqa: F401
