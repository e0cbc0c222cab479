"""The Digital Calibration Certificate of a run: XML for PTB's schema 3.3.0.

A sheet may have blanks, a certificate has none: what the schema asks for has to be stated.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from datetime import date
from xml.etree import ElementTree

from sklearn_raacmm.app._cells import TableError, parse_number
from sklearn_raacmm.app._report import render

_VERSION = "3.3.0"
_NEEDED = (
    "number", "laboratory", "country", "customer", "place", "item", "serial", "tested",
    "temperature", "authorised",
)  # fmt: skip
_SIDES = (
    ("before", "as found, µm", "beforeAdjustment"), ("after", "as left, µm", "afterAdjustment"),
)  # fmt: skip


def certificate(shown):
    """What the sheet shows as XML."""
    entries, labels = shown["entries"], shown["labels"]
    if missing := [labels[name] for name in _NEEDED if not entries[name]]:
        raise TableError(f"The certificate needs of the table sheet: {'; '.join(missing)}.")
    if not re.fullmatch("[A-Z]{2}", entries["country"]):
        raise TableError(
            f"{labels['country']}: two capitals, such as DE, got {entries['country']}."
        )
    days = {name: _days(labels[name], entries[name]) for name in ("received", "tested", "issued")}
    page = render(
        "_accept.xml", version=_VERSION, plain=_plain,
        um=lambda mm: f"{1e3 * mm:.1f}", sides=_SIDES[: 1 + shown["left"]],
        days=days, methods={one.standard: one for one in shown["result"].values}, **shown,
    )  # fmt: skip
    try:
        ElementTree.fromstring(page)
    except ElementTree.ParseError as error:  # such as of control characters
        raise TableError(f"The certificate would be no XML: {error}.") from None
    return page


def _days(label, text):
    """First and last day, as ISO 8601 has them; blanks for none."""
    try:
        days = [date.fromisoformat(day.strip()) for day in text.split("/")] if text else []
        if len(days) > 2 or days != sorted(days):
            raise ValueError
    except ValueError:
        raise TableError(
            f"{label}: a day such as 2026-11-23, or two, 2026-11-20/2026-11-23, got {text!r}."
        ) from None
    return [day.isoformat() for day in days] or [""]


def _plain(text):
    """A number as XML has it, "" for other text."""
    try:
        return f"{parse_number(text):g}"
    except TableError:
        return ""
