"""What `sarcal check` says, as one JSON object. The key names are a contract. Judges nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from operator_app.config.quantities import short_degrees
from operator_app.report.results.check import in_words
from operator_app.units.figure import Figure
from solver.chain.sensors import Encoder, NoSensor, Rvdt

if TYPE_CHECKING:
    from operator_app.config.any_file import Found
    from operator_app.config.errors import Problem
    from operator_app.planning.inspection import Chain
    from solver.chain.arm_model import Joint
    from solver.diagnostics.identifiability import Identifiability


def found_json(found: Found, chains: Sequence[Chain]) -> dict[str, Any]:
    """Return the object: the files, all that is wrong, and what would come of each arm in its fixture."""
    return {
        "files": [
            {"file": f.source.file, "kind": f.kind, "text": in_words(f)} for f in found.files
        ],
        "problems": [_problem(p) for p in found.problems],
        "chains": [_chain(chain) for chain in chains],
    }


def _problem(problem: Problem) -> dict[str, Any]:
    return {
        "file": problem.file,
        "line": problem.line,
        "column": problem.column,
        "key": problem.key,
        "text": problem.text,
        "remedy": problem.remedy,
    }


def _chain(chain: Chain) -> dict[str, Any]:
    found, arm = chain.outlook, chain.arm
    return {
        "procedure": chain.procedure or None,
        "arm": arm.name,
        "fixture": chain.fixture.name,
        "kind": chain.fixture.kind,
        "joints": [_joint(k, joint) for k, joint in enumerate(arm.joints, 1)],
        "mobility": found.mobility,
        "drives": None
        if found.choice is None
        else {"joints": list(found.choice.drives), "reasons": list(found.choice.reasons)},
        "home_deg": None if chain.home is None else short_degrees(chain.home[0]),
        "refusal": None if found.refusal is None else str(found.refusal),
        "checks": [c.data for c in found.checks],
        "parameters": [p.name for p in found.parameters],
        "held": dict(chain.held),
        "seen": None if found.seen is None else _seen(found.seen),
        "poses": {file: _seen(seen) for file, seen in chain.poses},
        "unfit": dict(chain.unfit),
        "assumed": list(arm.assumed),
    }


def _joint(number: int, joint: Joint) -> dict[str, Any]:
    kinds: dict[type, str] = {Encoder: "encoder", Rvdt: "rvdt", NoSensor: "none"}
    return {"joint": number, "name": joint.name, "sensor": kinds[type(joint.sensor)]}


def _seen(seen: Identifiability) -> dict[str, Any]:
    return {
        "rank": seen.rank,
        "scaled_condition_number": Figure(seen.scaled_condition_number).in_json,
        "not_identifiable": [
            {"parameters": list(d.parameters), "text": str(d)} for d in seen.directions
        ],
    }
