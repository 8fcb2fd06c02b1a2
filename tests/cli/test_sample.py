"""The command that writes a bundled photograph."""

import json

import pytest
from command_line import assert_fails_in_one_line, names_in, run
from PIL import Image

from napari_defocus.cli.sample import AUTHORS, sample_path


@pytest.mark.parametrize(("name", "size"), [("dandelion", (1000, 562)), ("brushes", (900, 708))])
def test_sample_is_written_and_its_author_named(tmp_path, name, size):
    done = run("sample", tmp_path / "picture.jpg", "--name", name)
    assert done.exit_code == 0, done.output
    assert AUTHORS[name] in done.stdout
    assert Image.open(tmp_path / "picture.jpg").size == size


def test_authors_are_those_of_the_list_beside_the_pictures():
    said = sample_path("dandelion").with_name("ATTRIBUTION.md").read_text(encoding="utf-8")
    for name, told in AUTHORS.items():
        title, author, licence = told.replace(" by ", " ").split(", ")
        [line] = [line for line in said.splitlines() if line.startswith(f"| {name}.jpg")]
        assert line.startswith(f"| {name}.jpg | *{title}*, {author} | {licence}")


def test_sample_replaces_nothing_unless_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report = json.loads(run("sample", "--json").stdout)
    assert report["files"] == ["photo.jpg"]
    (tmp_path / "photo.jpg").write_bytes(b"mine")
    assert_fails_in_one_line(run("sample"), saying="photo.jpg")
    assert (tmp_path / "photo.jpg").read_bytes() == b"mine"
    assert run("sample", "--force").exit_code == 0
    assert_fails_in_one_line(run("sample", "photo.png"), saying="must end in .jpg or .jpeg")
    assert names_in(tmp_path) == ["photo.jpg"]
