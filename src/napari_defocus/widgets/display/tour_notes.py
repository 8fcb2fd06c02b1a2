"""The notes of the tour, and which comes when: no Qt."""

from dataclasses import dataclass

from napari_defocus.widgets.display.dock_state import Stage

SAMPLE = "Open the sample"


@dataclass(frozen=True)
class Note:
    """What the tour says at a time.

    Attributes
    ----------
    text : str
    button : str
        What leads on; "" if only doing what it says does.
    """

    text: str
    button: str = ""


NOTES = (
    Note(
        "New here? Five notes lead through the main job. Open a sample, or a picture of your own.",
        SAMPLE,
    ),
    Note(
        "2 of 5: press “Measure”. It finds how blurred each pixel is: the radius, in px, of the "
        "disc that a point has become."
    ),
    Note(
        "3 of 5: purple is sharp, yellow is blurred, and the pink line encloses what is in focus. "
        "Do not trust what is veiled in grey. The status bar, at the bottom, tells the numbers "
        "under the mouse.",
        "Next",
    ),
    Note(
        "4 of 5: is the pink line wrong? Move “in focus up to (px)”, or press “New seeds layer” "
        "and paint what you know. The line follows.",
        "Next",
    ),
    Note(
        "5 of 5: open “Restore” and press “Take the blur away” for the picture without blur. "
        "“Why here?” explains any place.",
        "Done",
    ),
)


def followed(step: int, stage: Stage) -> int:
    """Return the step of the tour after what was done: from a picture on, and from a map on.

    Examples
    --------
    >>> followed(0, Stage.NO_PICTURE), followed(0, Stage.CHOSEN), followed(1, Stage.MEASURED)
    (0, 1, 2)
    """
    if step == 0 and stage is not Stage.NO_PICTURE:
        step = 1
    if step == 1 and stage in (Stage.MEASURED, Stage.OUTDATED):
        step = 2
    return step
