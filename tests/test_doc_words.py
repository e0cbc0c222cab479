"""Pages that people finish: how many words, how long sentences, how long docstrings."""

import sys
from pathlib import Path

import pytest

DOC = Path(__file__).resolve().parent.parent / "doc"


@pytest.fixture
def counts(monkeypatch):
    monkeypatch.syspath_prepend(DOC)
    import count_words

    yield count_words
    del sys.modules["count_words"]


def test_pages_and_docstrings_are_within_their_limits(counts, capsys):
    assert counts.main() == 0, capsys.readouterr().out


def test_the_script_sees_what_is_long(counts):
    long = "One " + "word " * counts.LONG_SENTENCE + "more."
    text = f"# A head of many words\n\n{long} Short one. Another?\n\n```\ncode. Is not read.\n```\n"
    sizes = [len(sentence.split()) for sentence in counts.sentences(text)]
    assert sizes == [counts.LONG_SENTENCE + 2, 2]  # a single word is no sentence
    listed = (
        "- First item of a list\n- Second one, with $x. Y$ and [a link](page.md)\n\n| a. B | c |\n"
    )
    assert [len(sentence.split()) for sentence in counts.sentences(listed)] == [5, 7]
    assert {page for kind in counts.pages().values() for page in kind} >= {"index.md", "log.md"}
    assert counts.docstrings()["RBFNetRegressor.fit"] > 100
