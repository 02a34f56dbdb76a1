"""Table of condition number, rank and chi2: what it says about stated errors that are far too large."""

from dataclasses import replace

import pytest

from operator_app.report.facts import facts_of


@pytest.mark.parametrize(("chi2_per_dof", "small"), [(0.099, True), (0.101, False)])
def test_errors_far_smaller_than_stated_are_reported(result, chi2_per_dof, small, approve):
    solution = result._subject.solution
    adjudication = replace(solution.adjudication, stated_chi2_per_dof=chi2_per_dof)
    note = facts_of(replace(solution, adjudication=adjudication)).table("determined").note
    assert ("below 0.1" in note) is small
    approve(note)
