"""Count the words of the pages: ``python doc/count_words.py``.

Prints the words of every page and of each kind of pages (as ``wc -w`` counts them, code and tables
included), how many sentences have more than 25 and 30 words, and the longest docstrings. Exit code
1 where a limit is exceeded, which ``tests/test_doc.py`` checks, too.
"""

import importlib
import inspect
import re
import sys
from pathlib import Path

DOC = Path(__file__).resolve().parent
DEVELOPERS = ("developers", "how_it_is_built", "numerics", "log")
RESULTS = ("benchmarks", "beyond_the_paper", "paper_and_ours")
LISTS = ("changelog", "citing", "code_of_conduct", "contributing", "glossary", "more", "references")
LISTS += ("maintenance", "roadmap")
MODULES = (
    "",
    ".acceptance",
    ".app",
    ".calibration",
    ".correction",
    ".datasets",
    ".display",
    ".export",
    ".metrics",
    ".residuals",
    ".utils",
)
# Most words of a kind, share of sentences with more than 30 words, most words of a docstring.
LIMITS = {"user": 12_000, "result": 2_200, "developer": 8_000}
LONG_SENTENCE, SHARE_OF_LONG, LONGEST_DOCSTRING = 30, 0.02, 900


def kind_of(page):
    """What a page is: for users, of results, for developers, or a list of what is looked up."""
    kinds = {"developer": DEVELOPERS, "result": RESULTS, "list": LISTS}
    return next((kind for kind, names in kinds.items() if page.stem in names), "user")


def pages():
    """Words of each page, by its kind."""
    found = {"user": {}, "result": {}, "developer": {}, "list": {}}
    for page in sorted([*DOC.glob("*.md"), *DOC.glob("user_guide/*.md")]):
        words = len(page.read_text(encoding="utf-8").split())
        found[kind_of(page)][str(page.relative_to(DOC))] = words
    return found


def sentences(text):
    """Sentences of a page in Markdown: no code, tables, headings, formulas or comments."""
    for out in (r"^(```|~~~).*?^\1", r"^\$\$.*?^\$\$", r"\$\$.*?\$\$", r"<!--.*?-->"):
        text = re.sub(out, "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^(#|\||:::|!\[|\{\{).*$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"^(\s*[-*]|\s*\d+\.|:) ", "\n\n", text, flags=re.MULTILINE)
    text = re.sub(r"\$[^$]*\$", "X", text)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    for paragraph in re.split(r"\n\s*\n", text):
        for sentence in re.split(r"(?<=[.?!])[)\"*]*\s+(?=[A-Z0-9`\"*\[({])", paragraph):
            if len(sentence.split()) > 1:
                yield " ".join(sentence.split())


def docstrings():
    """Words of the docstring of every public class, method and function."""
    found = {}
    for module in MODULES:
        part = importlib.import_module(f"sklearn_raacmm{module}")
        for name in part.__all__:
            thing = getattr(part, name)
            found[name] = _words(thing)
            if inspect.isclass(thing):
                for method, own in vars(thing).items():
                    if not method.startswith("_") and callable(own):
                        found[f"{name}.{method}"] = _words(own)
    return found


def _words(thing):
    return len((inspect.getdoc(thing) or "").split())


def main():
    """Print all counts; return 1 if one of them is above its limit."""
    above = False
    for kind, of_kind in pages().items():
        print(f"{sum(of_kind.values()):6d}  {kind} pages, of at most {LIMITS.get(kind, '-')}")
        above |= sum(of_kind.values()) > LIMITS.get(kind, 1e9)
        for name, words in sorted(of_kind.items(), key=lambda item: -item[1]):
            print(f"{words:10d}  {name}")
    texts = [path.read_text(encoding="utf-8") for path in (*DOC.rglob("*.md"), DOC / "../README.md")
             if "auto_examples" not in path.parts]  # fmt: skip
    sizes = [len(sentence.split()) for text in texts for sentence in sentences(text)]
    for limit in (25, LONG_SENTENCE):
        long = sum(size > limit for size in sizes)
        print(f"{long:6d}  of {len(sizes)} sentences have more than {limit} words", end="")
        print(f" ({100 * long / len(sizes):.1f} %)")
    above |= long > SHARE_OF_LONG * len(sizes)
    longest = sorted(docstrings().items(), key=lambda item: -item[1])[:8]
    print(f"{'':6}  longest docstrings, of at most {LONGEST_DOCSTRING} words")
    for name, words in longest:
        print(f"{words:10d}  {name}")
    return int(above or longest[0][1] > LONGEST_DOCSTRING)


if __name__ == "__main__":
    sys.exit(main())
