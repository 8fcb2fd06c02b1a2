"""What panels start: any work on a plane that returns results."""

from typing import Protocol

from napari_defocus.core.progress import Progress, silent
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.layers.image_layers import Plane
from napari_defocus.widgets.layers.result_metadata import Results


class Job(Protocol):
    """What is wanted of a plane: a frozen dataclass that refuses, when made, what cannot be."""

    @property
    def plane(self) -> Plane:
        """What it is made of."""

    def run(self, cache: JobCache, progress: Progress = silent) -> Results:
        """Return the results, in any thread.

        Parameters
        ----------
        cache : JobCache
            What earlier runs have found; what this one finds is added.
        progress : callable, optional
            See `napari_defocus.core.progress`. An exception from it ends the work, and nothing
            is left of it.
        """
