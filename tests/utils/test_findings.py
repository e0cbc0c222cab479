"""Findings as warnings, and warnings as findings."""

import warnings

import pytest

from sklearn_raacmm.utils import Finding, FindingWarning, collected_findings, report_findings

DOUBT = Finding("moved-position", "Position 'a' moved by 2 mm.", "Fasten it.")


def test_a_finding_is_said_as_a_warning_and_a_note_is_not():
    with pytest.warns(FindingWarning, match=r"Position 'a' moved by 2 mm\. Fasten it\.") as said:
        report_findings([Finding("dwells", "300 rows are 3 poses.", weight="note"), DOUBT])
    assert [warning.message.finding for warning in said] == [DOUBT]
    assert said[0].filename == __file__


def collected():
    with collected_findings() as heard:
        report_findings([DOUBT, DOUBT])
        warnings.warn("other", UserWarning, stacklevel=1)
    return heard


def test_heard_findings_are_collected_once_and_other_warnings_go_on():
    with pytest.warns(UserWarning, match="other") as said:
        assert collected() == [DOUBT]
    assert len(said) == 1
