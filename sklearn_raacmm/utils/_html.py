"""Values as HTML tables, for notebooks."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def html_table(title: str, header: Sequence[Any], rows: Iterable[Sequence[object]]) -> str:
    """HTML of a table under a line of text; all texts are escaped.

    Parameters
    ----------
    title : str
    header : sequence of str
        Names of the columns.
    rows : iterable of sequences
        Cells; numbers as they are to be shown.

    Returns
    -------
    str

    Examples
    --------
    >>> from sklearn_raacmm.utils import html_table
    >>> html_table("a < b", ["joint"], [[1]])
    '<div><p>a &lt; b</p><table><tr><th>joint</th></tr><tr><td>1</td></tr></table></div>'
    """

    def line(cells, tag):
        return "<tr>" + "".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    lines = [line(header, "th"), *(line(row, "td") for row in rows)]
    return f"<div><p>{escape(title)}</p><table>{''.join(lines)}</table></div>"
