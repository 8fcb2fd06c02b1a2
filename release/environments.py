"""Clean environments, and the tests run in them against what is installed there."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build"

_STRAY = "PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PYTHONSTARTUP"


class StepFailedError(Exception):
    """A command of a check failed; what it said was printed."""


def run(*command, cwd=ROOT, environment=None):
    """Run a command that must succeed, in an environment that holds no way to the source tree."""
    sys.stdout.flush()
    if subprocess.call([str(part) for part in command], cwd=cwd, env=environment or clean()) != 0:
        raise StepFailedError(" ".join(str(part) for part in command))


def clean(**more):
    """Return this process's variables without those that lead Python elsewhere."""
    return {name: value for name, value in os.environ.items() if name not in _STRAY} | more


def uv(*arguments):
    """Run uv, which tasks.py has installed beside this interpreter."""
    run(sys.executable, "-m", "uv", "--quiet", *arguments)


def find_python(version):
    """Return the path of a Python such as "3.12", None if this machine has none that runs."""
    candidates = [sys.executable, shutil.which(f"python{version}"), *_pyenv_pythons(version)]
    return next((path for path in candidates if path and _is_python(path, version)), None)


def _pyenv_pythons(version):
    # The shims that pyenv puts into PATH do not run unless their version is also the chosen one.
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    return sorted((root / "versions").glob(f"{version}.*/bin/python"), reverse=True)


def _is_python(path, version):
    code = "import sys; print('.'.join(map(str, sys.version_info[:2])))"
    try:
        answer = subprocess.run([path, "-c", code], capture_output=True, text=True, env=clean())
    except OSError:
        return False
    return answer.stdout.strip() == version


def make_environment(name, python, *packages):
    """Make a new environment of this name and install packages; return its interpreter."""
    folder = BUILD / "environments" / name
    uv("venv", "--clear", "--python", python, folder)
    interpreter = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    uv("pip", "install", "--python", interpreter, *packages)
    return interpreter


def program(interpreter, name):
    """Return the path of a program that a package has installed beside an interpreter."""
    return interpreter.with_name(name + interpreter.suffix)


def build():
    """Build the source distribution, and the wheel from it; return (wheel, sdist)."""
    folder = BUILD / "distributions"
    shutil.rmtree(folder, ignore_errors=True)
    uv("build", "--out-dir", folder, ROOT)
    [wheel], [sdist] = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


def tests_without_source(sdist):
    """Unpack a source distribution, take the package itself away, and return the folder."""
    folder = BUILD / "outside"
    shutil.rmtree(folder, ignore_errors=True)
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    [top] = folder.iterdir()
    shutil.rmtree(top / "src")
    return top


def run_tests(interpreter, folder, log, arguments=()):
    """Run the tests of a folder against what an interpreter has installed.

    Returns whether they passed, and pytest's last line. All that they say is printed and goes
    into the file `log`.
    """
    command = [interpreter, "-m", "pytest", "-n", "2", "--dist", "loadgroup", *arguments]
    log.parent.mkdir(parents=True, exist_ok=True)
    last = "nothing was said"
    with (
        log.open("w", encoding="utf-8") as file,
        subprocess.Popen(
            command, cwd=folder, env=clean(), text=True, errors="replace",
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ) as process,
    ):  # fmt: skip
        for line in process.stdout:
            print(line, end="", flush=True)
            file.write(line)
            last = line.strip() or last
    return process.returncode == 0, re.sub(r"^=+ | =+$", "", last)
