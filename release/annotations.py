"""Fail if a public name, or a name of a module that holds one, is not fully annotated."""

import json
import subprocess
import sys

import napari_defocus


def incomplete_names():
    """Return what basedpyright does not know the type of."""
    command = ["basedpyright", "--verifytypes", "napari_defocus", "--ignoreexternal"]
    answer = subprocess.run([*command, "--outputjson"], capture_output=True, text=True)
    symbols = json.loads(answer.stdout)["typeCompleteness"]["symbols"]
    assert any(symbol["isExported"] for symbol in symbols), "the type checker found no public name"
    return [
        symbol["name"]
        for symbol in symbols
        if not symbol["isTypeKnown"] and symbol["name"].startswith(public_prefixes())
    ]


def public_prefixes():
    """Return how the full names of the public names begin, and of all in their modules."""
    names = napari_defocus.__all__
    homes = {getattr(napari_defocus, name).__module__ for name in names}
    return tuple(f"{home}." for home in homes) + tuple(f"napari_defocus.{name}" for name in names)


if __name__ == "__main__":
    names = incomplete_names()
    print("public names that are not fully annotated:", len(names))
    sys.exit("\n".join(names) or 0)
