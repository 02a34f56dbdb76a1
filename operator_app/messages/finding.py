"""A finding: a fault or fact with place, magnitude, probability, and whether it blocks acceptance.

The kind of a finding has the templates of text and remedy; no code parses figures from these texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

from operator_app.messages.finding_kind import FindingKind

__all__ = ["CERTAIN", "Finding", "FindingKind", "NamedSize"]

CERTAIN = 0.5
"""A finding is stated as a fact if its probability is at least this, otherwise as a possibility."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedSize:
    """A parameter and a value in `unit`, "rad" or "m"; `share`: fraction of the information that is from the poses."""

    name: str
    size: float
    unit: str
    share: float | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding.

    Attributes
    ----------
    joint, joints
        The joint (1-based, 0 for none), and all joints if several; or, in `joints`, numbers of placements or sockets.
    sensor
        "RVDT" or "ENCODER" if the finding is about a joint's sensor.
    names
        Parameters, entries, fixtures or files concerned.
    size, sigma, unit
        Magnitude of the finding, its standard uncertainty, and the unit of both: "rad", "m", or "" for a plain number.
    figures
        Other figures, in SI units, by the names that the templates use.
    sizes
        Values of several parameters.
    reported
        Text and remedy that a lower layer wrote (fixtures, solver, file readers).
    probability
        Probability of this finding among all explanations, one of which is that there is no fault.
    doubted
        Whether the finding is stated as a possibility, whatever its probability.
    blocking
        Whether the finding prevents acceptance: parameters may be wrong by more than their sigmas allow.
    """

    kind: FindingKind
    _: KW_ONLY
    joint: int = 0
    joints: tuple[int, ...] = ()
    sensor: str = ""
    names: tuple[str, ...] = ()
    poses: tuple[str, ...] = ()
    size: float | None = None
    sigma: float | None = None
    unit: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
    sizes: tuple[NamedSize, ...] = ()
    reported: tuple[str, ...] = ()
    probability: float = 1.0
    doubted: bool = False
    blocking: bool = False

    @staticmethod
    def upgraded_record(data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Convert a record to the current format; records of earlier versions have code, text and remedy."""
        if "kind" in data:
            return data
        return {
            "kind": FindingKind.REPORTED.name,
            "names": [data["code"]],
            "reported": [data["text"], data.get("remedy", "")],
            "probability": data.get("probability", 1.0),
            "blocking": data.get("refuses", False),
        }

    @property
    def code(self) -> str:
        """The public code, such as ``FROZEN_JOINT_3``."""
        return self.kind.code.format(
            joint=self.joint,
            sensor=self.sensor,
            name=self.names[0] if self.names else "",
            names="_".join(self.names),
        )

    @property
    def certain(self) -> bool:
        """Whether the finding is stated as a fact."""
        return self.probability >= CERTAIN and not self.doubted

    @property
    def text(self) -> str:
        """The text of the finding."""
        return self._filled(self.kind.text)

    @property
    def remedy(self) -> str:
        """The remedy; empty if the text is sufficient."""
        return self._filled(self.kind.remedy)

    @property
    def brief(self) -> str:
        """The sentence or, if it is long, a short form for a small panel."""
        return self._filled(self.kind.brief) or self.sentence

    @property
    def sentence(self) -> str:
        """Text and remedy together."""
        return ": ".join(part for part in (self.text, self.remedy) if part)

    def _filled(self, template: str) -> str:
        from operator_app.messages.calibration import FindingFields

        return template.format_map(FindingFields(self))
