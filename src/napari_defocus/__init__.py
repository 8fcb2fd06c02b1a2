"""Defocus blur of a single picture: how wide, how sure, what is in focus.

Public names and where they live are listed in `__init__.pyi`. Each is loaded when it is first
used, so that importing the package costs next to nothing and never imports napari or Qt.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# It needs dask, which comes with the extra "large": `import *` must do without.
__all__.remove("LazyCandidates")
