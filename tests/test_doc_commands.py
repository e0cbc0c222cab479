"""The command beside a number: its script is there, and takes these arguments."""

import argparse
import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BENCHMARKS = ROOT / "benchmarks"
NAMED = re.compile(r"\b(?:benchmarks/\w+|bench_\w+|make_results|golden)\.py\b")
# Between backticks or quotes, or alone on a line of an example, up to its comment.
COMMAND = re.compile(
    r"""(?:(?P<mark>`+|")(?:python\ )?|^[ ]*[\w./]*python\ )(?:benchmarks/)?
    (?P<script>(?:bench_\w+|make_results|golden)\.py)
    (?P<arguments>(?(mark)[\w\s./-]*(?=(?P=mark))|[^#\n]*))""",
    re.MULTILINE | re.VERBOSE,
)


def texts():
    """Contents of all that names commands: pages, sources, and what draws and tests."""
    folders = ("doc/*.md", "doc/user_guide/*.md", "doc/*.py", "doc/benchmarks.json", "*.md")
    folders += ("sklearn_raacmm/**/*.py", "examples/*.py", "benchmarks/*.py", "tests/**/*.py")
    for pattern in folders:
        for path in ROOT.glob(pattern):
            if path != Path(__file__):
                # A command that goes on in the next line of a comment.
                yield re.sub(r"(?<=\S)\n# ", " ", path.read_text(encoding="utf-8"))


class _MadeError(Exception):
    """Carries the parser of a script, before it does anything."""


@pytest.fixture
def parser_of(script, monkeypatch):
    """Return ``parser_of(name)``: a script's ArgumentParser, made by its own ``main``."""
    parse = argparse.ArgumentParser.parse_args

    def stop(self, *_):
        raise _MadeError(self)

    def made(name):
        monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
        with pytest.raises(_MadeError) as error:
            script(name.removesuffix(".py")).main()
        monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse)
        return error.value.args[0]

    return made


def test_every_script_that_is_named_is_there():
    named = {name for text in texts() for name in NAMED.findall(text)}
    assert len(named) > 10
    assert [n for n in named if not (BENCHMARKS / n.removeprefix("benchmarks/")).exists()] == []


def test_every_script_takes_the_arguments_of_its_commands(parser_of, capsys):
    found = (found for text in texts() for found in COMMAND.finditer(text))
    known = sorted({(one["script"], one["arguments"]) for one in found})
    assert len(known) > 60
    parsers, refused = {}, []
    for script, arguments in known:
        if script not in parsers:
            parsers[script] = parser_of(script)
        parser = parsers[script]
        needed = arguments.strip() or not any(a.required for a in parser._actions)
        try:
            # The name alone is no command where the script asks for a part.
            if needed:
                parser.parse_args(shlex.split(arguments))
        except SystemExit:
            refused.append((script, arguments, capsys.readouterr().err.splitlines()[-1]))
    assert refused == []


def test_every_script_is_in_the_list_of_benchmarks_with_options_that_it_has(parser_of):
    text = (ROOT / "doc" / "benchmarks.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+\.py)` \|(.*)$", text, flags=re.MULTILINE)
    assert sorted(dict(rows)) == sorted(path.name for path in BENCHMARKS.glob("[!_]*.py"))
    for script, row in rows:
        known = parser_of(script).format_help()
        assert [option for option in re.findall(r"`(--[\w-]+)", row) if option not in known] == []
