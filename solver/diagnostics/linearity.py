"""Is a sensor's curve larger than stated, where a bound is all that is stated of it? Knows scenes; no words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from solver.diagnostics.fault_model import Stray
from solver.diagnostics.fault_models import Scene
from solver.diagnostics.hypothesis_tests import Test
from solver.diagnostics.model_selection import evidence
from solver.diagnostics.whitened_residuals import LeftOver


def but_curves_as_stated(
    tests: Iterable[Test], scene: Scene, left: LeftOver, measured: Mapping[int, Stray]
) -> Iterable[Test]:
    """Tests but for those of curves that stray no further than stated: that bound is all that is stated.

    How large a curve is as a whole within it is believed by habit, and one that ripples is larger.
    """
    for test in tests:
        joint = test.code.removeprefix("VARIANCE_CURVE_")
        if not (test.fires and joint.isdigit() and _as_stated(int(joint), scene, left, measured)):
            yield test


def _as_stated(j: int, scene: Scene, left: LeftOver, measured: Mapping[int, Stray]) -> bool:
    """Whether the curve of joint j is within its linearity but for chance, by the loop if that measured it."""
    curve = scene.curve(j)
    if curve is None:
        return False
    if j in measured:
        return not measured[j].beyond(curve.most_stated)
    found = evidence(left, curve.columns, curve.natural, most=curve.most)
    return found is not None and curve.is_stated(found.b, found.covariance)
