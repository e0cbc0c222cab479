"""Findings: what is said about the data, once, in every place that shows it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

from sklearn_raacmm.utils._warn_user import warn_user


@dataclass(frozen=True)
class Finding:
    """What was found in the data, or in what was made of them.

    Attributes
    ----------
    code : str
        Short name of the kind, of small letters and hyphens, such as "moved-position".
    text : str
        One sentence: what was found, with its numbers and units.
    advice : str
        One sentence: what to do. Empty if there is nothing to do.
    weight : {"note", "doubt", "repair"}
        "note": good to know. "doubt": results may be worse than they look. "repair": no judgement
        of the correction means anything before this is put right.
    positions : tuple
        Labels of the positions that it is about; empty if it is about all.
    rows : tuple of int
        Rows, counted from 0.
    joints : tuple of int
        Joints, counted from 1.
    size_mm : float or None
        How large it is at the probe, mm.
    """

    code: str
    text: str
    advice: str = ""
    weight: Literal["note", "doubt", "repair"] = "doubt"
    positions: tuple[Any, ...] = ()
    rows: tuple[int, ...] = ()
    joints: tuple[int, ...] = ()
    size_mm: float | None = None

    def __str__(self) -> str:
        return f"{self.text} {self.advice}".rstrip()


class FindingWarning(UserWarning):
    """A warning that says a finding; ``warning.finding`` is the value."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(str(finding))
        self.finding = finding


def say_findings(findings: Iterable[Finding]) -> None:
    """Warn of each finding that is more than a note."""
    for finding in findings:
        if finding.weight != "note":
            warn_user(FindingWarning(finding))


@contextmanager
def heard_findings() -> Iterator[list[Finding]]:
    """Collect the findings that are said within, instead of warning; other warnings go on.

    Yields
    ------
    list of Finding
        Filled when the block ends, each finding once.
    """
    heard: list[Finding] = []
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UserWarning)
        yield heard
    for warning in said:
        if isinstance(warning.message, FindingWarning):
            if warning.message.finding not in heard:
                heard.append(warning.message.finding)
        else:
            warn_user(warning.message)
