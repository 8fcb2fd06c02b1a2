"""The terminal command run inside of a test, and how it has to fail."""

import errno
import os

from typer.testing import CliRunner

from napari_defocus.cli.app import app


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def assert_fails_in_one_line(result, *, saying, code=2):
    assert result.exit_code == code, result.output
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("napari-defocus: ")
    assert saying in lines[0]


def full_disk(_descriptor):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
