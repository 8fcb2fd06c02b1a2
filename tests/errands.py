"""Functions for another process to run: it imports this file, so that this imports little."""

import os
import signal
import sys
import time


def process_id(*_, progress):
    return os.getpid()


def names_of_modules(*, progress):
    return sorted(sys.modules)


def doubled(array, *, progress):
    array *= 2
    return array


def endless(*, progress):
    """Report once, then nothing, as within a long cut."""
    progress("at work", 0.5)
    time.sleep(3600)


def reporting(*, progress):
    """Report often, without end."""
    while True:
        progress("at work", 0.5)
        time.sleep(0.01)


def dying(how, *, progress):
    how(os.getpid())


def ended_by_the_system(pid):
    os.kill(pid, signal.SIGKILL)


def ended_with_code_3(pid):
    os._exit(3)


def chatter(*, progress):
    print("printed")
    os.write(1, b"written")
    os.write(2, b"complained")
    return sys.stdin.read()


class OddError(Exception):
    def __init__(self, what, why):
        super().__init__(f"{what} because {why}")


def failing_oddly(*, progress):
    raise OddError("it fails", "it can")
