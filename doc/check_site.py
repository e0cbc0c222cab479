"""Check the built site without a network: ``python doc/check_site.py doc/_build/html``.

Every local link has to lead to a file, and to an anchor of it where it names one. Nothing of the
building machine or of a failed build may stand in the text: no path of the project's folder, no
traceback, no number that was not filled in. The page of a script of the gallery has to have its
pictures, and what the script prints. Exit code 1 and one line for each finding otherwise.
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

PROJECT = Path(__file__).resolve().parent.parent
# What must not be read on a page; sources of the package, shown as they are, are exempt.
UNWANTED = {
    "a path of the building machine": re.compile(
        re.escape(str(PROJECT)) + r"\b|/(?:home|tmp|root)/\w"
    ),
    "a traceback": re.compile(r"Traceback \(most recent call last\):(?!\s+\.\.\.)"),
    "a number that was not filled in": re.compile(r"\{\{ ?\w+ ?\}\}"),
}

# How many pictures the page of a script has, and words that the script prints; the others have
# tests of their own.
GALLERY = {
    "plot_after_the_lab": (2, "week 7, suspect: harmonics of joint 2"),
    "plot_how_many_poses": (1, "poses"),
    "plot_learn_correction": (1, "It repeats better at new positions"),
    "plot_newrb": (1, "neurons, mean squared error"),
    "plot_ols_path": (1, "auto: "),
    "plot_paper_figures": (3, "gauges of 500 mm"),
    "plot_periodicity": (1, "periodic"),
    "plot_rbf_network": (1, "2-D"),
    "plot_simulated_arm": (1, "noise floor"),
}


class Page(HTMLParser):
    """Links, anchors and text of one page."""

    def __init__(self, text):
        super().__init__()
        self.links, self.anchors, self.words, self.printed = [], set(), [], []
        self._hidden = self._output = 0
        self.feed(text)

    def has(self, fragment):
        """Tell whether a link to this place of the page finds it."""
        return unquote(fragment) in self.anchors

    def handle_starttag(self, tag, attributes):
        """Collect links and anchors."""
        self._hidden += tag in ("script", "style")
        if tag == "div":  # what a script of the gallery prints, and all that is inside
            is_output = "sphx-glr-script-out" in (dict(attributes).get("class") or "")
            self._output += self._output > 0 or is_output
        for name, value in attributes:
            if name == "id" or (name == "name" and tag == "a"):
                self.anchors.add(value)
            elif name in ("href", "src") and value:
                self.links.append(value)

    def handle_endtag(self, tag):
        """Leave scripts, and what they print."""
        self._hidden -= tag in ("script", "style")
        self._output -= tag == "div" and self._output > 0

    def handle_data(self, data):
        """Collect what is read."""
        if not self._hidden:
            self.words.append(data)
            self.printed += [data] * (self._output > 0)


def findings(folder):
    """One line for each broken link and each unwanted text of a built site."""
    folder = Path(folder).resolve()
    pages = {
        path: Page(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("*.html"))
        if "_static" not in path.relative_to(folder).parts  # files of the theme
    }
    if not pages:
        yield f"{folder} holds no pages"
    for path, page in pages.items():
        name = path.relative_to(folder)
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target /= "index.html"
            if not target.exists():
                yield f"{name}: no file for the link {link}"
            elif parts.fragment and target in pages and not pages[target].has(parts.fragment):
                yield f"{name}: no anchor for the link {link}"
        if name.parts[0] != "_modules":
            text = "".join(page.words)
            for what, pattern in UNWANTED.items():
                if found := pattern.search(text):
                    yield f"{name}: {what}: {text[found.start() : found.start() + 60]!r}"
    gallery = folder / "auto_examples"
    for script in GALLERY if gallery.is_dir() else ():
        yield from missing(script, pages.get(gallery / f"{script}.html", Page("")))


def missing(script, page):
    """One line for each picture and word that the page of a script lacks."""
    n_pictures, said = GALLERY[script]
    drawn = set(re.findall(rf"{script}_\d+\.png", " ".join(page.links)))
    if len(drawn) != n_pictures:
        yield f"{script}: {len(drawn)} pictures, not {n_pictures}"
    if said not in "".join(page.printed):
        yield f"{script}: it does not print {said!r}"


if __name__ == "__main__":
    lines = list(findings(sys.argv[1]))
    print(*lines, sep="\n", end="\n" if lines else "")
    sys.exit(bool(lines))
