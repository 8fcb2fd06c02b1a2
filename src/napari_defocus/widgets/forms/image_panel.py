"""What the widgets that work on one image layer share: choose it, ask, show what was made."""

import threading
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, ClassVar, TypeVar

import pint
from magicgui.widgets import ComboBox
from napari.components import ViewerModel
from napari.layers import Image, Layer
from napari.utils.notifications import show_info, show_warning

from napari_defocus.widgets.display.add_results import add_results_stepwise, prepare_napari
from napari_defocus.widgets.forms.region_field import RegionField
from napari_defocus.widgets.forms.run_panel import RunPanel
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.job import Job
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane, shown_plane
from napari_defocus.widgets.layers.result_metadata import (
    MEASURED_PSF,
    METADATA_KEY,
    Results,
    made_by_us,
    pictures_in,
)

T = TypeVar("T")


@cache
def prepare() -> None:
    """Load what the first run needs while its user looks at the form."""
    # Layers need pint's units, and of two threads that load these at once, one finds none.
    pint.Unit("pixel")
    threading.Thread(target=prepare_napari, daemon=True).start()


class ImagePanel(RunPanel):
    """Work on the shown plane of one image layer, in a worker thread.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
        Where the images come from and the results go.
    action : str
        What the run button says.

    Attributes
    ----------
    image : magicgui.widgets.ComboBox
        The image layer.
    region : RegionField
        What part of it.
    cache : JobCache
        Shared by all widgets: the mask reuses what the map has found.
    """

    cache: ClassVar[JobCache] = JobCache()

    def __init__(self, napari_viewer: ViewerModel, *, action: str) -> None:
        super().__init__(napari_viewer, action=action)
        self.image = ComboBox(
            name="image",
            label="image",
            choices=self._images,
            tooltip="The image layer to analyse. Of a stack, the plane that is shown.",
        )
        self.region = RegionField(napari_viewer)
        prepare()

    def _images(self, _: Any) -> list[Image]:
        return pictures_in(self._viewer.layers)

    def _choose_active(self) -> None:
        """Choose the active image layer; only once the fields are in a form."""
        active = self._viewer.layers.selection.active
        if active in self.image.choices:
            self.image.value = active

    def _last_measured(self) -> str:
        measured = [layer for layer in self._viewer.layers if made_by_us(layer) == MEASURED_PSF]
        return measured[-1].metadata[METADATA_KEY]["file"] if measured else ""

    def shown_plane(self) -> Plane:
        """Return the part of the chosen image's plane that the form and the viewer choose.

        Raises
        ------
        NotAnalysableError
            If there is no image, or it shows no such plane.
        """
        if self.image.value is None:
            raise NotAnalysableError("there is no image.")
        return self.region.part_of(shown_plane(self.image.value, self._viewer.dims))

    def _asked_for(self, work: Callable[[], T]) -> T | None:
        """Return what `work` reads from the form; None, with a warning, if it cannot be done."""
        if self.image.value is None:
            show_warning("There is no image to analyse. Open an image first.")
            return None
        try:
            return work()
        except NotAnalysableError as reason:
            show_warning(f"Cannot analyse “{self.image.value.name}”: {reason}")
        except ValueError as reason:
            show_warning(str(reason))
        return None

    def _run_job(self, ask: Callable[[], Job], action: str = "") -> Run | None:
        """Start the work that the form asks for, and return it; None if it cannot be done.

        The results are in the viewer when the run's `finished` signal comes. While one runs,
        that one is returned.
        """
        if self._running is not None:
            return self._running
        job = self._asked_for(ask)
        return None if job is None else self._start_job(job, action)

    def _start_job(self, job: Job, action: str = "") -> Run:
        return self._start(
            partial(job.run, self.cache),
            self._show_results,
            [job.plane],
            f"{action or self.run_button.text}: {job.plane.name}",
        )

    def _show_results(self, results: Results) -> Iterator[Layer]:
        if self._still_current():
            keep = self._keeps_earlier()
            yield from add_results_stepwise(self._viewer, results.layers, keep_earlier=keep)
            self.say(results.summary)

    def _keeps_earlier(self) -> bool:
        """Tell whether the results of earlier runs stay."""
        return False

    def _still_current(self) -> bool:
        """Tell whether the plane that was worked on is as it was; if it was changed, say so."""
        plane = self._planes[0]
        if plane.is_current(self._viewer.layers):
            return True
        if plane.layer() in self._viewer.layers:
            show_info(f"“{plane.name}” was changed while it was analysed. Run again.")
        return False
