"""Pieces of C99 source: names, numbers, tables and comments that cannot be anything else."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
import textwrap
from pathlib import Path
from string import Template

import numpy as np

# C99 promises 63 significant characters within a file; the rest is for what is appended.
_MAX_NAME = 40
_PARTS = re.split(
    r"^//// (\w+)\n",
    Path(__file__).with_name("_templates.c").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)
_TEMPLATES = dict(zip(_PARTS[1::2], map(Template, _PARTS[2::2]), strict=True))


def template(name, /, **given):
    """One part of ``_templates.c``, its places filled."""
    return _TEMPLATES[name].substitute(given)


def check_name(name):
    """A prefix for C functions, or one clear sentence."""
    fits = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name, re.ASCII)
    if not fits or "__" in name or len(name) > _MAX_NAME:
        raise ValueError(
            "name must be a C identifier: a letter, then letters, digits or single underscores, "
            f"at most {_MAX_NAME} characters; got {name!r:.60}."
        )
    return name


def comments(**given):
    """Comments on the public functions, by name."""
    return dict(
        re.findall(r"^= (\w+): (.*(?:\n   .*)*)", template("comments", **given), re.MULTILINE)
    )


def plain(text):
    """Text that may stand in a comment or between quotes: it cannot end it, nor splice lines.

    Letters, digits and what is no part of a trigraph, an escape or a quotation; the rest becomes
    underscores.
    """
    return re.sub(r"[^A-Za-z0-9 _.,:;=+()\[\]'|#%<>/-]", "_", str(text))


def comment(lines):
    """Lines of a C comment, without its ends; long ones go on in the next line."""
    text = ""
    for line in lines:
        wrapped = textwrap.wrap(plain(line), 96, initial_indent=" * ", subsequent_indent=" *     ")
        text += "\n".join(wrapped or [" *"]) + "\n"
    return text


class Tables:
    """Literals of one precision, and tables of constants and helping functions, each there once.

    Literals are the shortest decimals that read back as the same number. Tables of float32 are of
    single precision in any case.
    """

    def __init__(self, dtype):
        self.real, self.n_bytes = dtype, 0  # of all tables written so far
        self.dtype = np.float64 if dtype == "double" else np.float32
        self.suffix = "" if dtype == "double" else "f"
        self.helpers, self._texts, self._names = {}, [], {}

    def __call__(self, name, array, note=""):
        """Name of a table: of whole numbers, if its type is such."""
        array = np.asarray(array)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._names:
            self._names[key] = f"{name}_{len(self._names)}"
            self._texts.append(self.table(self._names[key], array, note))
        return self._names[key]

    def c(self, name, /, **given):
        """One part of ``_templates.c`` in this precision."""
        return template(name, **{"real": self.real, "f": self.suffix, **given})

    def help(self, name, /, **given):
        """Add a function that others call."""
        self.helpers[name] = self.c(name, **given)

    @property
    def text(self):
        return "\n".join([*self.helpers.values(), *self._texts])

    def literal(self, value):
        """One number."""
        single = self.dtype is np.float32 or getattr(value, "dtype", None) == np.float32
        with np.errstate(over="ignore"):
            number = np.float32(value) if single else np.float64(value)
        if not np.isfinite(number):
            raise ValueError(
                f"The model holds {float(value):g}, which is not a finite {self.real}: it cannot "
                "be written as C."
            )
        text = np.format_float_scientific(number, trim="-", exp_digits=1)
        if 1e-4 <= abs(number) < 1e9 or number == 0:
            text = np.format_float_positional(number, trim="0")
        return text + "f" * single

    def table(self, name, array, note=""):
        """A static constant array of one or two dimensions, of numbers or of whole numbers."""
        array = np.asarray(array)
        kind, literal, size = "int", str, 4
        if array.dtype.kind == "f":
            kind = "float" if array.dtype == np.float32 else self.real
            literal, size = self.literal, 4 if kind == "float" else 8
        else:
            array = array.astype(int)
            if np.all(np.abs(array) < 2**15):
                kind, size = "short", 2
        self.n_bytes += size * array.size
        shape = "".join(f"[{n}]" for n in array.shape)
        if array.ndim == 1:
            body = _wrap(array, literal, "    ")
        else:
            rows = [_wrap(row, literal, "     ") for row in array]
            body = ",\n".join("    {" + text[5:] + "}" for text in rows)
        head = f"/* {note} */\n" if note else ""
        return f"{head}static const {kind} {name}{shape} = {{\n{body}\n}};\n"


def _wrap(values, literal, indent):
    """Values with commas, in lines of limited width."""
    return textwrap.fill(
        ", ".join(map(literal, values)), 95, initial_indent=indent, subsequent_indent=indent,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
