"""What the dock says, as a function of what is so: no Qt and no napari.

`DockState` holds facts. `DockState.stage` names the situation, and `DockState.text` says it.
Nothing that is said stays longer than the facts that it is about.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from enum import Enum, auto

RELIEF_HINT = "Turn the relief with the mouse. “Back to 2-D” brings everything back."


_NO_PICTURES = "Only image layers can be measured, and only those that are no results."


class Stage(Enum):
    """The situations of the dock."""

    NO_PICTURE = auto()
    CHOSEN = auto()
    RUNNING = auto()
    UPDATING = auto()
    MEASURED = auto()
    OTHER_PLANE = auto()
    OUTDATED = auto()
    CHANGED = auto()
    GONE = auto()


@dataclass(frozen=True)
class Measured:
    """What the last run on the chosen picture has left.

    Attributes
    ----------
    lines : str
        What there is to say about it.
    run : int
        Tells it from that of another run.
    there : bool
        Whether its layers are in the viewer.
    plane : tuple of int or None
        Of a stack, which plane was measured; None for a single picture and for all planes.
    outdated : bool
        Whether the form asks for something else now.
    """

    lines: str
    run: int = 0
    there: bool = True
    plane: tuple[int, ...] | None = None
    outdated: bool = False


@dataclass(frozen=True)
class Notice:
    """What was done last, and when that is worth saying.

    Attributes
    ----------
    text : str
    situation : hashable
        `DockState.situation` when it was said: it is said as long as that lasts.
    """

    text: str
    situation: Hashable


@dataclass(frozen=True)
class DockState:
    """What is so.

    Attributes
    ----------
    picture : str or None
        Name of the chosen image layer, None if there is none.
    others : bool
        Whether there are other layers, if there is none.
    count : int
        How many planes it has.
    plane : tuple of int
        Which of them is shown; empty for a single picture.
    all_planes : bool
        Whether all of them are to be measured.
    step : str
        What a run does now; empty if none runs.
    updating : bool
        Whether map and mask are made again for other settings.
    measured : Measured or None
        What is known of the chosen picture.
    changed : bool
        Whether its pixels were exchanged since.
    relief : bool
        Whether a relief is shown in 3-D.
    results : frozenset
        Tells the result layers that are in the viewer from others.
    notice : Notice or None
    action : str
        What the button says that measures.
    """

    picture: str | None = None
    others: bool = False
    count: int = 1
    plane: tuple[int, ...] = ()
    all_planes: bool = False
    step: str = ""
    updating: bool = False
    measured: Measured | None = None
    changed: bool = False
    relief: bool = False
    results: frozenset[int] = frozenset()
    notice: Notice | None = None
    action: str = "Measure"

    @property
    def stage(self) -> Stage:
        """The situation."""
        if self.step:
            return Stage.RUNNING
        if self.picture is None:
            return Stage.NO_PICTURE
        if self.measured is None:
            return Stage.CHOSEN
        return self._of_results(self.measured)

    def _of_results(self, measured: Measured) -> Stage:
        if not measured.there:
            return Stage.GONE
        if self.changed:
            return Stage.CHANGED
        if self.updating:
            return Stage.UPDATING
        if measured.plane is not None and measured.plane != self.plane:
            return Stage.OTHER_PLANE
        return Stage.OUTDATED if measured.outdated else Stage.MEASURED

    @property
    def situation(self) -> Hashable:
        """What a notice lasts as long as: picture, results and view, but no run."""
        run = None if self.measured is None else self.measured.run
        return self.picture, self.plane, run, self.changed, self.relief, self.results

    @property
    def text(self) -> str:
        """What the dock says."""
        stage = self.stage
        if stage in (Stage.RUNNING, Stage.UPDATING):
            return self.step or "Updating map and mask"
        if self.notice is not None and self.notice.situation == self.situation:
            return self.notice.text
        if self.relief:
            return RELIEF_HINT
        return self._text_of(stage)

    def _text_of(self, stage: Stage) -> str:
        again = f"Press “{self.action}”"
        if stage is Stage.NO_PICTURE:
            wanted = f"Open a picture (File > Open File(s)...), then press “{self.action}”."
            return f"{_NO_PICTURES} {wanted}" if self.others else wanted
        if stage is Stage.CHOSEN:
            return self._invitation()
        if stage is Stage.GONE:
            return f"The results of “{self.picture}” were removed. {again} to have them again."
        if stage is Stage.CHANGED:
            return (
                f"“{self.picture}” was changed after it was measured. {again} to renew its results."
            )
        assert self.measured is not None
        if stage is Stage.OTHER_PLANE:
            return (
                f"Plane {_named(self.measured.plane)} was measured; plane {_named(self.plane)} is "
                f"shown. {again} to measure it, too."
            )
        if stage is Stage.OUTDATED:
            return f"{again} to apply what was changed.\n{self.measured.lines}"
        return self.measured.lines

    def _invitation(self) -> str:
        if self.count == 1:
            return f"Press “{self.action}”: how blurred is “{self.picture}”, and where?"
        if self.all_planes:
            return f"Press “{self.action}” to measure all {self.count} planes of “{self.picture}”."
        return (
            f"“{self.picture}” has {self.count} planes; plane {_named(self.plane)} is shown. Press "
            f"“{self.action}” to measure it, or choose “all planes” first."
        )


def _named(plane: tuple[int, ...] | None) -> str:
    return ", ".join(map(str, plane or ()))
