"""Full disks, signals and a lack of memory, in processes of their own: nothing half-written."""

import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import contextmanager

import numpy as np
import pytest
import tifffile
from command_line import names_in
from PIL import Image

needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="has other signals and limits")

WRITE_A_STACK = """
    import numpy as np, sys
    from napari_defocus.io.tiff_writer import write_pyramidal_tiff
    value, path = float(sys.argv[1]), sys.argv[2]
    stack = np.full((2, 2048, 2048), value, np.float32)
    print("begun", flush=True)
    write_pyramidal_tiff(path, stack, axes="zyx", description={}, force=True)
"""
"""32 MB that compress to nearly nothing; their smaller levels wait in 11 MB of scratch files."""


def python(code, *arguments, **options):
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    return subprocess.Popen(command, **options)


def ended(process):
    out, error = process.communicate()
    return process.returncode, out, error


@pytest.fixture
def picture(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (60, 64), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "seed.png")
    tifffile.imwrite(tmp_path / "blur.tif", pixels.astype(np.float32) / 64)
    return tmp_path / "seed.png"


def depth_of(picture, *more):
    """Return the arguments of a command that measures nothing and so is quick."""
    lens = {"focal-length": 50, "f-number": 2, "focus-distance": 2, "pixel-pitch": 5}
    options = [word for name, value in lens.items() for word in (f"--{name}", value)]
    return ["depth", picture, "--map", picture.with_name("blur.tif"), *options, "--force", *more]


# --- a disk that is full --------------------------------------------------------------------


@contextmanager
def small_disk(folder, size):
    """Lend a file system of so many bytes; only root can make one."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    made = shutil.which("mount") and subprocess.run(mount, capture_output=True).returncode == 0
    if not made:
        pytest.skip("no file system can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_full_disk_ends_in_words_and_not_the_process(tmp_path):
    """Scratch files with holes would end it with SIGBUS."""
    with small_disk(tmp_path / "disk", 2_000_000) as disk:
        (disk / "map.ome.tif").write_bytes(b"old")
        code, _, error = ended(python(WRITE_A_STACK, 1, disk / "map.ome.tif"))
        assert (code, "No space left on device" in error) == (1, True), error
        assert {path.name: path.read_bytes() for path in disk.iterdir()} == {"map.ome.tif": b"old"}


def test_command_on_a_full_disk_leaves_what_was_there(tmp_path, picture):
    with small_disk(tmp_path / "disk", 12_000) as disk:
        (disk / "map.tif").write_bytes(b"old")
        results = ["-o", disk / "map.tif", "-o", disk / "more.tif"]
        code, out, error = ended(python(COMMAND, *depth_of(picture, *results)))
        assert (code, out) == (2, "")
        assert error.startswith(f"napari-defocus: cannot write {disk}")
        assert len(error.splitlines()) == 1
        assert {path.name: path.read_bytes() for path in disk.iterdir()} == {"map.tif": b"old"}


@needs_posix
def test_limit_for_the_size_of_files_ends_in_words(tmp_path):
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))\n{}"
    code, _, error = ended(
        python(limited.format(textwrap.dedent(WRITE_A_STACK)), 1, tmp_path / "map.ome.tif")
    )
    assert (code, "File too large" in error) == (1, True), error
    assert names_in(tmp_path) == []


# --- a process that is ended ----------------------------------------------------------------

COMMAND = "from napari_defocus.cli.app import main; main()"

COMMAND_THAT_WAITS = """
    import signal, sys, time
    from pathlib import Path
    from napari_defocus.cli import app as cli
    from napari_defocus.core import writing
    write, waits = writing._write_through, Path(sys.argv.pop())

    def slowly(path, content):
        write(path, content)
        waits.touch()
        time.sleep(3600)

    writing._write_through = slowly
    signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.main()
"""
"""Waits when its first file is written, under a temporary name."""


@needs_posix
@pytest.mark.parametrize(
    ("sent", "code", "said"), [("SIGINT", 130, "interrupted"), ("SIGTERM", 143, "ended")]
)
def test_ended_while_it_writes_the_command_leaves_what_was_there(picture, sent, code, said):
    result, waits = picture.with_name("map.tif"), picture.parent.parent / f"{sent}-waits"
    result.write_bytes(b"old")
    process = python(COMMAND_THAT_WAITS, *depth_of(picture, "-o", result, waits))
    until(waits.exists, process)
    process.send_signal(getattr(signal, sent))
    assert ended(process) == (code, "", f"napari-defocus: {said}\n")
    assert names_in(picture.parent) == ["blur.tif", "map.tif", "seed.png"]
    assert result.read_bytes() == b"old"


@needs_posix
def test_what_nohup_ignores_stays_ignored():
    code = """
        import signal
        from napari_defocus.cli.console import end_as_after_ctrl_c
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        end_as_after_ctrl_c()
        signal.raise_signal(signal.SIGHUP)
        print("goes on")
    """
    assert ended(python(code)) == (0, "goes on\n", "")


@needs_posix
def test_killed_while_it_writes_a_stack_leaves_the_old_one_and_one_part(tmp_path):
    """What is left goes by a name that says so; scratch files have none."""
    path = tmp_path / "map.ome.tif"
    path.write_bytes(b"old")
    killed = "import os, signal\nos.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)\n{}"
    code, _, error = ended(python(killed.format(textwrap.dedent(WRITE_A_STACK)), 1, path))
    assert code == -signal.SIGKILL, error
    assert path.read_bytes() == b"old"
    left = [name for name in names_in(tmp_path) if name != path.name]
    assert [name for name in left if not name.startswith(".napari-defocus-")] == []
    assert len(left) == 1


def until(is_so, process):
    while not is_so():
        assert process.poll() is None, "it ended before"
        time.sleep(0.05)


# --- two at once, and too little of memory --------------------------------------------------


def test_two_that_write_the_same_stack_leave_one_of_both_whole(tmp_path):
    path = tmp_path / "map.ome.tif"
    both = [python(WRITE_A_STACK, value, path) for value in (1, 2)]
    for process in both:
        code, _, error = ended(process)
        assert code == 0, error
    written = tifffile.imread(path)
    assert (written == written[0, 0, 0]).all()
    assert names_in(tmp_path) == ["map.ome.tif"]


@needs_posix
def test_too_little_memory_is_said_in_one_line(tmp_path):
    """The limit is set when everything is imported; the picture alone is above it."""
    Image.new("L", (7000, 7000)).save(tmp_path / "large.png")
    code = """
        import os, resource
        import napari_defocus.labeling.blur_map, tifffile
        from napari_defocus.cli.app import main
        pages = int(open("/proc/self/statm").read().split()[0])
        limit = pages * resource.getpagesize() + 150_000_000
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        main()
    """
    if not os.path.exists("/proc/self/statm"):  # noqa: PTH110
        pytest.skip("does not tell how much memory a process has")
    process = python(code, "map", tmp_path / "large.png", "-o", tmp_path / "map.tif")
    code, out, error = ended(process)
    assert (code, out) == (2, ""), error
    assert "there is not enough memory" in error
    assert len(error.splitlines()) == 1
    assert names_in(tmp_path) == ["large.png"]
