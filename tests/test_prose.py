"""The check of the documentation's language finds what is hard to read, and nothing else."""

import runpy
from pathlib import Path

import pytest

pytest.importorskip("proselint")
CHECK = runpy.run_path(str(Path(__file__).parents[1] / "docs" / "check_prose.py"))


def faults_in(tmp_path, text, name="page.md"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return list(CHECK["faults_of"](CHECK["prose_of"](tmp_path / name)))


def test_short_sentences_and_common_words_are_no_fault(tmp_path):
    assert faults_in(tmp_path, "# A title\n\nThe map says how wide the blur is.\n") == []


def test_a_long_sentence_is_found_with_its_line(tmp_path):
    [(line, fault)] = faults_in(tmp_path, "Short.\n\n- An item.\n- Then" + " word" * 30 + ".\n")
    assert line == 4
    assert "a sentence of 32 words: '- Then word word" in fault


@pytest.mark.parametrize("text", ["It is no picture.", "It must be used\nin order to see."])
def test_words_that_readers_stumble_over_are_found(tmp_path, text):
    assert len(faults_in(tmp_path, text)) == 1


@pytest.mark.parametrize(
    "text",
    [
        "```sh\nin order to\n```\n",
        "$$\nhence\n$$\n",
        "| hence | thus |\n",
        "[a page](in-order-to-hence.md) and `hence` and $thus$.\n",
    ],
)
def test_code_equations_tables_and_links_are_not_looked_at(tmp_path, text):
    assert faults_in(tmp_path, text) == []


def test_comments_of_a_script_are_looked_at_and_its_code_is_not(tmp_path):
    script = '"""\nTitle\n=====\n\nHence this.\n"""\nhence = 1\n# %%\n# Thus that.\n'
    assert [line for line, _ in faults_in(tmp_path, script, "plot_a.py")] == [5, 9]
