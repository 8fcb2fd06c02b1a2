"""Labels that follow the sliders: roughly at once, finely when they rest."""

from collections.abc import Callable
from typing import Any

from napari.types import LayerDataTuple
from qtpy.QtCore import QObject, QTimer

from napari_defocus.core.progress import Progress
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import Analysed, JobCache

SOON = 30
"""Milliseconds in which further changes are waited for."""

AT_REST = 250
"""Milliseconds without a change after which the fine details of a large picture are worked out."""

PREVIEWS = "previews"
"""The channel of the worker process that makes them: they do not wait for the results."""


class LiveLabels(QObject):
    """Labels what was analysed again whenever it is asked to; only the last wish counts.

    Parameters
    ----------
    cache : JobCache
    take : callable
        Gets the layers, what was analysed and how, and whether they are all that is wanted: a
        preview is not.
    parent : QObject
        With it, this ends.
    at_rest : callable, optional
        Called when nothing is wanted any more, whatever has become of it.
    """

    def __init__(
        self,
        cache: JobCache,
        take: Callable[[list[LayerDataTuple], Analysed, Analysis, bool], None],
        parent: QObject,
        at_rest: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(parent)
        self._on_rest = at_rest
        self._cache = cache
        self._take = take
        self._wanted: tuple[Analysed, Analysis] | None = None
        self._wish = 0
        self._shown = 0
        self._preview: Run | None = None
        self._result: Run | None = None
        self._soon, self._at_rest = _timer(self, SOON), _timer(self, AT_REST)
        self._soon.timeout.connect(self._show_preview)
        self._at_rest.timeout.connect(self._work_out)

    @property
    def is_busy(self) -> bool:
        """Whether something is still to come."""
        return self._wanted is not None

    def want(self, analysed: Analysed, analysis: Analysis) -> None:
        """Label a plane again, as an analysis says; what was wanted before is not any more."""
        self._wanted = analysed, analysis
        self._wish += 1
        if self._result is not None:
            self._result.cancel()
        if analysed.is_large:
            if not self._soon.isActive():
                self._soon.start()
            self._at_rest.start(AT_REST)
        else:
            self._at_rest.start(SOON)

    def prepare(self, analysed: Analysed, analysis: Analysis) -> None:
        """Make the first preview as quick as the others will be."""
        if analysed.is_large and self._preview is None:
            self._preview = self._start_preview(analysed, analysis)

    def stop(self) -> None:
        """Want nothing any more."""
        self._wanted = None
        self._wish += 1
        for timer in (self._soon, self._at_rest):
            timer.stop()
        for run in (self._preview, self._result):
            if run is not None:
                run.cancel()

    def _show_preview(self) -> None:
        if self._wanted is None or self._preview is not None:
            return
        self._preview = self._start_preview(*self._wanted)

    def _start_preview(self, analysed: Analysed, analysis: Analysis) -> Run:
        return self._start(
            analysed,
            analysis,
            lambda progress: analysis.preview(analysed, progress, PREVIEWS),
            whole=False,
        )

    def _work_out(self) -> None:
        if self._wanted is None:
            return
        if self._result is not None:
            self._at_rest.start(SOON)  # it was cancelled, and has not ended yet
            return
        analysed, analysis = self._wanted
        self._result = self._start(
            analysed,
            analysis,
            lambda progress: analysis.labelled(analysed, self._cache, progress),
            whole=True,
        )

    def _start(
        self,
        analysed: Analysed,
        analysis: Analysis,
        work: Callable[[Progress], Any],
        *,
        whole: bool,
    ) -> Run:
        wish = self._wish

        def take(layers: list[LayerDataTuple]) -> None:
            if self._is_news(wish, whole):
                self._take(layers, analysed, analysis, whole)

        run = Run(work, "", owner=self)
        run.returned.connect(take)
        run.finished.connect(lambda: self._on_finished(wish, whole))
        run.start()
        return run

    def _is_news(self, wish: int, whole: bool) -> bool:
        if self._wanted is None or wish <= self._shown or (whole and wish < self._wish):
            return False
        if whole:
            self._shown = wish
            self._wanted = None
        return True

    def _on_finished(self, wish: int, whole: bool) -> None:
        if whole:
            self._result = None
            if wish == self._wish:
                self._wanted = None
                self._on_rest()
            return
        self._preview = None
        if self._wanted is not None and wish < self._wish:
            self._show_preview()


def _timer(parent: QObject, interval: int) -> QTimer:
    timer = QTimer(parent)
    timer.setSingleShot(True)
    timer.setInterval(interval)
    return timer
