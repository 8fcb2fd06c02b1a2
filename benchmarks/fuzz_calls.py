"""Random calls of every public function, for fuzz.py."""

import fuzz_files  # noqa: F401
import fuzz_lenses  # noqa: F401
import fuzz_maps  # noqa: F401
import fuzz_pictures  # noqa: F401
from fuzz_call import RECIPES, Call, described, random_call

__all__ = ["RECIPES", "Call", "described", "random_call"]
