import gc
import os
import sys
import time
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from napari.components import ViewerModel
from napari.utils.notifications import notification_manager
from pytestqt.qtbot import QtBot

import napari_defocus
from napari_defocus import Cancelled, RestorationFit, ShotNoise, pipeline
from napari_defocus.core.intensity import Intensities
from napari_defocus.settings import USUAL_THRESHOLD

ONLY_WHAT_HANGS = 600_000
"""Milliseconds to wait for what has to come: a busy machine is slow, and that is no mistake."""


def has_display():
    needs_one = sys.platform.startswith("linux")
    return not needs_one or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    if item.get_closest_marker("display") is None or has_display():
        return
    reason = "needs a display: install Xvfb and pytest-xvfb, or run under xvfb-run"
    if os.environ.get("CI"):
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)


def pytest_collection_finish():
    """Leave what the libraries made out of the search for garbage at the end of every window.

    Once, before there is any of Qt's objects: those must not outlive their window.
    """
    gc.collect()
    gc.freeze()


def pytest_sessionfinish():
    gc.unfreeze()


@pytest.fixture(autouse=True)
def _nothing_kept(request, monkeypatch):
    """Start without what other tests have found, and without the developer's Preferences."""
    from napari_defocus.widgets.layers import preferences

    if "plugin_settings" not in request.fixturenames:
        monkeypatch.setattr(preferences, "_explicit", dict)
    if request.node.get_closest_marker("display") is None:
        return
    from napari_defocus.widgets.forms import run_panel
    from napari_defocus.widgets.forms.image_panel import ImagePanel
    from napari_defocus.widgets.jobs.estimation import JobCache

    monkeypatch.setattr(ImagePanel, "cache", JobCache())
    if "usual_pauses" not in request.fixturenames:
        monkeypatch.setattr(run_panel, "PAUSE", 0)  # nobody watches what is drawn meanwhile


@pytest.fixture
def usual_pauses():
    """For tests of what a user feels: results appear step by step, as ever."""


@pytest.fixture(autouse=True)
def _no_thread_searches_for_garbage():
    """While a test has windows, no thread of ours may find what is left of them.

    Python searches for garbage in whichever thread makes objects. What is Qt's is then deleted by
    the main thread, at its next chance (Shiboken::BindingManager::runDeletionInMainThread), and
    PySide6 6.11 now and then calls a destructor there that is gone: a segmentation fault, mostly in
    a later test, of threads that have nothing to do with windows.
    """
    gc.disable()
    yield
    gc.enable()
    gc.collect(1)


@pytest.fixture(autouse=True, scope="module")
def _no_garbage_is_left_to_other_files():
    """What is left is none, such as modules: later searches, 1 s among all of it, leave it out."""
    yield
    gc.collect()
    gc.freeze()


class PatientQtBot(QtBot):
    """Waits for what has to come however long it takes; no test may depend on how long."""

    def waitUntil(self, callback, *, timeout=ONLY_WHAT_HANGS):  # noqa: N802
        super().waitUntil(callback, timeout=timeout)

    def waitSignal(self, signal, *, timeout=ONLY_WHAT_HANGS):  # noqa: N802
        return super().waitSignal(signal, timeout=timeout)


@pytest.fixture
def qtbot(qapp, request):
    return PatientQtBot(request)


@pytest.fixture
def viewer():
    return ViewerModel()


@pytest.fixture
def window(make_napari_viewer_proxy, monkeypatch):
    """A real one. It does not search all of memory for garbage whenever a layer goes.

    napari does so for graphics drivers of Windows, also for layers that go with their window. Among
    all that a session of tests has made, each search takes 0.6 s. napari's fixture searches once
    more, at the end, if something of its window is still there.
    """
    from napari._vispy import canvas

    monkeypatch.setattr(canvas, "gc", SimpleNamespace(collect=lambda: gc.collect(1)))
    return make_napari_viewer_proxy()


@pytest.fixture
def messages():
    notification_manager.records.clear()
    return lambda: [record.message for record in notification_manager.records]


@pytest.fixture
def opened(viewer, qtbot):
    def open_widget(widget_class):
        widget = widget_class(viewer)
        qtbot.addWidget(widget.native)
        return widget

    return open_widget


@pytest.fixture
def docked(window):
    def dock(widget_class):
        widget = widget_class(window)
        window.window.add_dock_widget(widget)
        return widget

    return dock


@pytest.fixture
def finish(qtbot):
    def run(widget):
        running = widget.run()
        assert running is not None
        with qtbot.waitSignal(running.finished):
            pass

    return run


@pytest.fixture
def texture():
    return np.random.default_rng(1).uniform(0.1, 0.9, (96, 128)).astype(np.float32)


@dataclass
class StandIn:
    """The method's steps, at once and counted."""

    radius: float = 2.5
    noise_variance: float = 3e-5
    misfit: float = 0.0
    estimations: list = field(default_factory=list)
    noises: list = field(default_factory=list)
    labelings: list = field(default_factory=list)
    segmentations: list = field(default_factory=list)
    restorations: list = field(default_factory=list)
    refocusings: list = field(default_factory=list)

    def estimate_candidates(self, image, *, progress, **arguments):
        self.estimations.append({"image": image, **arguments})
        progress("Estimating blur", 0.5)
        return SimpleNamespace(
            psf_choice=None,
            doubt=None,
            image_shape=image.shape[:2],
            noise_variance=self.noise_variance,
            shot_noise=None,
            noise_growth=0.0,
            psf=arguments["psf"],
            intensities=Intensities(0.0, 255.0, "number type"),
        )

    def estimate_shot_noise(self, image, **arguments):
        self.noises.append(arguments)
        return ShotNoise(1e-5, 1e-4)

    def label_blur_map(self, candidates, image, *, progress, **arguments):
        self.labelings.append(arguments)
        return np.full(candidates.image_shape, self.radius, np.float32)

    def confidence_map(self, candidates, blur_map):
        return np.linspace(0, 1, blur_map.size, dtype=np.float32).reshape(blur_map.shape)

    def cautious_blur_map(self, candidates, blur_map, *, risk):
        return 0.75 * blur_map

    def segment_in_focus(self, candidates, image, *, progress, threshold, **arguments):
        self.segmentations.append({"threshold": threshold, **arguments})
        return np.full(candidates.image_shape, self.radius <= threshold, np.uint8)

    def focus_threshold(self, candidates, image, *, progress, **arguments):
        return USUAL_THRESHOLD

    def restore_all_in_focus(self, image, blur_map, *, progress, **arguments):
        self.restorations.append({"image": image, "blur_map": blur_map, **arguments})
        progress("Taking the blur away", 0.5)
        sharp = np.full((*image.shape[:2], 3)[: image.ndim], 0.25, np.float32)
        left = np.full(image.shape[:2], 0.125, np.float32)
        weight = arguments["tv_weight"] or 2e-3
        return sharp, RestorationFit(arguments["noise_variance"], weight, self.misfit, left)

    def change_focus(self, image, blur_map, *, progress, **arguments):
        self.refocusings.append({"image": image, "blur_map": blur_map, **arguments})
        progress("Blurring again", 0.5)
        return np.full_like(arguments["all_in_focus"], arguments["focus"] / 10)


@pytest.fixture
def method(monkeypatch):
    stand_in = StandIn()
    for name in (
        "estimate_candidates",
        "estimate_shot_noise",
        "label_blur_map",
        "confidence_map",
        "cautious_blur_map",
        "segment_in_focus",
        "focus_threshold",
        "restore_all_in_focus",
        "change_focus",
    ):
        monkeypatch.setitem(vars(napari_defocus), name, getattr(stand_in, name))
    monkeypatch.setattr(pipeline, "threshold_of_planes", lambda *_, **__: USUAL_THRESHOLD)
    return stand_in


class Endless:
    """Work that goes on until a report of it ends it."""

    def __init__(self):
        self.has_begun = self.was_ended = False

    def work(self, step, progress):
        self.has_begun = True
        try:
            for _ in range(3000):
                progress(step, 0.25)
                time.sleep(0.01)
        except Cancelled:
            self.was_ended = True
            raise


@pytest.fixture
def endless():
    """Endless work; whoever begins it has to end it."""
    work = Endless()
    yield work
    assert work.was_ended == work.has_begun


@pytest.fixture
def endless_method(method, endless, monkeypatch):
    """A method whose estimation goes on until its progress callback ends it."""

    def estimate_candidates(image, *, progress, **arguments):
        method.estimations.append(image)
        endless.work("Estimating blur", progress)

    monkeypatch.setitem(vars(napari_defocus), "estimate_candidates", estimate_candidates)
    return method
