"""What a developer runs: ``python3 tasks.py`` and one of ``demo``, ``test``, ``lint``, ``docs``.

Before a release: ``nox``, with the sessions of noxfile.py.
Needs nothing but Python; everything else is installed into .venv beside this file.
"""

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

# For whoever starts this with an older Python than the package takes.
if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit(
        "tasks.py: napari-defocus needs Python 3.11 or newer, this is " + sys.version.split()[0]
    )

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")

OLDEST_PIP = (25, 1)  # the first one that knows --group

LINES_APART = 10.0
"""Seconds between two lines about pip, where they do not replace each other."""

EXTRAS = "napari,large,heic,raw,microscopes,slides,matting"

PACKAGES_OF = {
    "demo": ["-e", "."],
    "development": ["-e", f".[{EXTRAS}]", "--group", "test", "--group", "lint"],
    "docs": ["-e", ".[large]", "--group", "docs"],
    "release": ["--group", "release"],
}

# What else has the packages that are asked for.
ALSO_HELD_BY = {"demo": {"development", "docs"}}

PACKAGE_OF_PROGRAM = {"Xvfb": "xvfb", "xauth": "xauth"}

# What Qt's xcb platform and OpenGL load under Xvfb, and the Debian package of each.
PACKAGE_OF_LIBRARY = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libOpenGL.so.0": "libopengl0",
    "libdbus-1.so.3": "libdbus-1-3",
    "libfontconfig.so.1": "libfontconfig1",
    "libglib-2.0.so.0": "libglib2.0-0",
    "libX11-xcb.so.1": "libx11-xcb1",
    "libxkbcommon-x11.so.0": "libxkbcommon-x11-0",
    "libxcb-cursor.so.0": "libxcb-cursor0",
    "libxcb-icccm.so.4": "libxcb-icccm4",
    "libxcb-image.so.0": "libxcb-image0",
    "libxcb-keysyms.so.1": "libxcb-keysyms1",
    "libxcb-randr.so.0": "libxcb-randr0",
    "libxcb-render-util.so.0": "libxcb-render-util0",
    "libxcb-shape.so.0": "libxcb-shape0",
    "libxcb-sync.so.1": "libxcb-sync1",
    "libxcb-xfixes.so.0": "libxcb-xfixes0",
    "libxcb-xkb.so.1": "libxcb-xkb1",
}

# The plugins of pytest that the tests use, as modules. Left to itself it loads all that are
# installed, and rewrites every module of their packages (all of napari) in each of its processes.
PLUGINS_OF_TESTS = [
    "_hypothesis_pytestplugin",
    "napari.utils._testsupport",
    "npe2._pytest_plugin",
    "pytest_timeout",
    "pytestqt.plugin",
    "xdist.plugin",
]

# Drivers that OpenGL picks at run time: no library name to try.
PACKAGES_WITHOUT_LIBRARY = ["libgl1-mesa-dri"]


def main(arguments):
    tasks = {
        "demo": demo,
        "test": test,
        "lint": lint,
        "docs": docs,
        "nox": nox,
    }
    if not arguments or arguments[0] not in tasks:
        sys.exit(f"usage: python3 tasks.py {{{'|'.join(tasks)}}} [arguments]")
    os.chdir(ROOT)
    return tasks[arguments[0]](arguments[1:])


def demo(arguments):
    install("demo")
    return call(BIN / "napari-defocus", "demo", *arguments)


def test(arguments):
    install("development")
    if sys.platform == "linux":
        install_display_packages()
    shared = "-n", "2", "--dist", "loadscope", "--no-loadscope-reorder"
    return call(PYTHON, "-m", "pytest", *shared, *arguments, env=environment_of_tests())


def environment_of_tests():
    """Return the environment in which pytest and what it starts begin sooner."""
    plugins = [*PLUGINS_OF_TESTS, *(["pytest_xvfb"] if sys.platform == "linux" else [])]
    told = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": ",".join(plugins)}
    # Tests start dozens of processes: each would read the package's source anew.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | told


def lint(_arguments):
    install("development")
    checks = ["ruff", "check"], ["ruff", "format", "--check"], ["mypy"], ["lint-imports"]
    results = [call(BIN / program, *options) for program, *options in checks]
    return max(*results, call(PYTHON, Path("docs", "check_prose.py")))


def docs(arguments):
    """Build the documentation into docs/_build/html; every warning is an error."""
    install("docs")
    pages = Path("docs", "_build", "html")
    strictly = "--fail-on-warning", "--keep-going", "--quiet"
    failed = call(PYTHON, "-m", "sphinx", *strictly, *arguments, "docs", pages)
    return failed or call(PYTHON, Path("docs", "check_links.py"), pages)


def nox(arguments):
    """Run the checks before a release, which make environments of their own."""
    install("release")
    if sys.platform == "linux":
        install_display_packages()
    return call(PYTHON, "-m", "nox", *arguments)


def call(*command, env=None):
    sys.stdout.flush()
    return subprocess.call(command, env=env)


def install(packages):
    """Make .venv hold what is asked for; costs nothing if it does already."""
    make_venv()
    wanted = hashlib.sha256((ROOT / "pyproject.toml").read_bytes() + bytes(ROOT)).hexdigest()
    if any(stamp(name) == wanted for name in {packages, *ALSO_HELD_BY.get(packages, ())}):
        return
    print(f"Installing into {VENV.name}; the first time this takes a minute or more.", flush=True)
    stamp_path(packages).unlink(missing_ok=True)
    upgrade_pip()
    pip("install", *PACKAGES_OF[packages])
    stamp_path(packages).write_text(wanted)


def stamp_path(packages):
    return VENV / f"installed-{packages}.txt"


def stamp(packages):
    path = stamp_path(packages)
    return path.read_text() if path.exists() else None


def make_venv():
    if venv_version() == sys.version_info[:2]:
        return
    print(f"Making {VENV.name} for Python {sys.version.split()[0]}.", flush=True)
    if subprocess.call([sys.executable, "-m", "venv", "--clear", VENV]) != 0:
        sys.exit("tasks.py: no virtual environment could be made (on Debian: python3-venv)")


def venv_version():
    """Return the (major, minor) of the Python in .venv, None if it or its pip does not run."""
    code = "import sys, pip; print(*sys.version_info[:2])"
    try:
        answer = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True)
    except OSError:
        return None
    return tuple(map(int, answer.stdout.split())) if answer.returncode == 0 else None


def upgrade_pip():
    answer = subprocess.check_output(
        [PYTHON, "-c", "import pip; print(pip.__version__)"], text=True
    )
    version = tuple(int(part) for part in answer.split(".")[:2])
    if version < OLDEST_PIP:
        pip("install", "--upgrade", f"pip>={'.'.join(map(str, OLDEST_PIP))}")


def pip(*arguments):
    if show_steps([PYTHON, "-m", "pip", "--disable-pip-version-check", *arguments]) != 0:
        sys.exit("tasks.py: pip failed, see above")


def show_steps(command):
    """Run pip and say what it is at; show all that it said only if it fails."""
    said = []
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with (
        Steps() as steps,
        subprocess.Popen(command, text=True, errors="replace", **piped) as process,
    ):
        for line in process.stdout:
            said.append(line)
            step = step_of_pip(line)
            if step is not None:
                steps.show(step)
    if process.returncode != 0:
        print("".join(said), end="", flush=True)
    return process.returncode


def step_of_pip(line):
    """Return what a line of pip says in few words, None if nothing new happens in it."""
    first, _, rest = line.strip().partition(" ")
    if first in {"Collecting", "Processing", "Obtaining"}:
        return f"looking at {name_of_package(rest)}"
    if first in {"Downloading", "Using"}:
        return f"downloading {name_of_package(rest.removeprefix('cached '))}{size_in(rest)}"
    if first in {"Building", "Preparing"}:
        return "building"
    if line.startswith("Installing collected packages:"):
        count = line.count(",") + 1
        return f"installing {count} package{'s' * (count > 1)}"
    return None


def name_of_package(text):
    """Return the name at the beginning of a requirement, or in the path of a file."""
    path = text.split(" (")[0].strip().rstrip("/")
    return re.split(r"[<>=!~;\[ ]|-\d", re.split(r"[/\\]", path)[-1])[0]


def size_in(text):
    size = re.search(r"\([\d.]+ [kMG]?B\)", text)
    return f" {size[0]}" if size else ""


class Steps:
    """What is done, and for how long: a line that changes, or without a terminal a few lines."""

    def __init__(self):
        self.changes = sys.stdout.isatty()
        self.started, self.printed = time.monotonic(), -LINES_APART
        self.step, self.ended, self.lock = "", threading.Event(), threading.Lock()

    def __enter__(self):
        threading.Thread(target=self.go_on, daemon=True).start()
        return self

    def __exit__(self, *_):
        with self.lock:
            self.ended.set()
            if self.changes:
                self.write_over("")
                print("\r", end="", flush=True)

    def show(self, step):
        with self.lock:
            self.step = step
            self.write()

    def go_on(self):
        """Let the seconds go on where pip says nothing for long."""
        while not self.ended.wait(1.0):
            with self.lock:
                if self.step and not self.ended.is_set():
                    self.write()

    def write(self):
        now = time.monotonic()
        line = f"  {now - self.started:.0f} s: {self.step}"
        if self.changes:
            self.write_over(line)
        elif now - self.printed >= LINES_APART:
            self.printed = now
            print(line, flush=True)

    def write_over(self, text):
        """Write over the line that is there."""
        width = shutil.get_terminal_size().columns - 1
        print(f"\r{text[:width]:{width}}", end="", flush=True)


def install_display_packages():
    missing = missing_display_packages()
    if not missing:
        return
    print("Installing for the display of the tests:", *missing, flush=True)
    become_root = [] if os.geteuid() == 0 else ["sudo", "-n"]
    installed = shutil.which("apt-get") is not None and all(
        run_quietly([*become_root, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", *step])
        for step in (["update"], ["install", "-y", "--no-install-recommends", *missing])
    )
    if not installed or missing_display_packages():
        sys.exit(
            "tasks.py: the tests of the widgets need these (names of Debian), please install "
            "them: " + " ".join(missing)
        )


def missing_display_packages():
    programs = [
        package for name, package in PACKAGE_OF_PROGRAM.items() if shutil.which(name) is None
    ]
    libraries = [package for name, package in PACKAGE_OF_LIBRARY.items() if not loads(name)]
    others = [package for package in PACKAGES_WITHOUT_LIBRARY if known_missing(package)]
    return programs + libraries + others


def loads(library):
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def known_missing(package):
    """Tell whether dpkg, where there is one, says that a package is not installed."""
    if shutil.which("dpkg-query") is None:
        return False
    query = ["dpkg-query", "--show", "--showformat=${db:Status-Status}", package]
    return "installed" not in subprocess.run(query, capture_output=True, text=True).stdout.split()


def run_quietly(command):
    try:
        answer = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        print(error)
        return False
    if answer.returncode != 0:
        print(answer.stdout + answer.stderr)
    return answer.returncode == 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
