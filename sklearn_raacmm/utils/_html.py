"""Values as HTML tables, for notebooks."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def html_table(title: str, header: Sequence[Any], rows: Iterable[Sequence[object]]) -> str:
    """HTML of a table under a line of text; all texts are escaped."""

    def line(cells, tag):
        return "<tr>" + "".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    lines = [line(header, "th"), *(line(row, "td") for row in rows)]
    return f"<div><p>{escape(title)}</p><table>{''.join(lines)}</table></div>"
