"""Output of `sarcal check` as text and JSON: problems of files, or a forecast of a calibration."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fixtures.base import CheckKind, Severity
from operator_app import units
from operator_app.config.any_file import FileRead, FilesRead
from operator_app.config.errors import Problem
from operator_app.config.fixture_file import FixtureSpec
from operator_app.config.parameters_file import ParametersDocument
from operator_app.config.poses_file import FileWarning, LoadedPoses
from operator_app.config.procedure import Procedure
from operator_app.config.quantities import short_degrees
from operator_app.planning.feasibility import Chain
from operator_app.report.text import aligned, paragraph, warning
from operator_app.units import Figure, joints_named, others_free, plural
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.parameters import DhKind
from solver.chain.sensors import Encoder, NoSensor, Rvdt
from solver.diagnostics.identifiability import Identifiability

UNITS_NOTE = (
    "Units are in the keys and columns: _deg degrees, _m metres, _mm millimetres, _mrad milliradians. "
    "Angles are sensor readings; joint angle = reading + theta_off."
)
FORECAST_NOTE = (
    "! Whether these poses allow a calibration was not checked: name the arm and the fixture "
    "as well, or the procedure."
)


def problems_text(problems: Sequence[Problem]) -> str:
    """Return all problems, file by file, one line each, in a format from which editors can open the file."""
    count = len(problems)
    files = list(dict.fromkeys(p.file for p in problems))
    many = f" in {len(files)} files" if len(files) > 1 else ""
    head = f"{plural(count, 'problem')}{many}:"
    ordered = sorted(problems, key=lambda p: (files.index(p.file), p.line or 0, p.column or 0))
    return "\n".join([head, *(f"! {problem}" for problem in ordered)])


def check_text(files: FilesRead, chains: Sequence[Chain]) -> str:
    """Return text on each file and each arm, and predicted results of calibrating each arm in its fixture."""
    arms = {chain.arm.name: chain.arm for chain in chains}
    arms |= {arm.name: arm for arm in files.of(ArmModel)}
    listed = aligned([[read.source.file, _file_text(read)] for read in files.files], left=True)
    doubts = [f"{f.source.file}: {w.text}" for f in files.files for w in _warnings(f)]
    blocks = [
        "\n".join([f"No problems were found in the files.\n{listed}", *map(warning, doubts)]),
        *map(_arm, arms.values()),
        *map(_chain, chains),
        *([paragraph(FORECAST_NOTE)] if files.of(LoadedPoses) and not chains else []),
        paragraph(UNITS_NOTE),
    ]
    return "\n\n".join(blocks)


def _warnings(read: FileRead) -> tuple[FileWarning, ...]:
    return read.content.warnings if isinstance(read.content, LoadedPoses) else ()


def _file_text(read: FileRead) -> str:
    match read.content:
        case ArmModel() as arm:
            return f"arm {arm.name}: {plural(arm.joint_count, 'joint')}"
        case FixtureSpec() as spec:
            return f"fixture {spec.name}: {spec.kind}"
        case Procedure(capture=capture) as procedure:
            how = "planned" if capture.strategy == "planned" else "explored"
            return (
                f"procedure {procedure.name}: {procedure.arm.name} in {procedure.fixture.name}, "
                f"{plural(capture.poses, f'{how} pose')} of {capture.samples_per_pose} samples"
            )
        case ParametersDocument() as document:
            return f"parameters of {document.arm.model}, serial {document.arm.serial}"
        case LoadedPoses() as loaded:
            poses, places = loaded.poses, len(loaded.poses.placements)
            measured = "" if poses.endpoint is None else ", measured endpoints"
            return (
                f"{plural(len(poses), 'pose')} of {plural(poses.q_rad.shape[1], 'joint')}, "
                f"{plural(places, 'placement')}{measured}"
            )
        case None:
            return "cannot be read"
        case profile:
            return f"bus profile {profile.name}"


def _arm(arm: ArmModel) -> str:
    free = {entry.name for entry in arm.free}
    rows = [["joint", "name", "range [deg]", "sensor", "reads to [deg]", "offset"]]
    for j, joint in enumerate(arm.joints, 1):
        span = f"{units.SPAN(joint.lower_rad).shown} to {units.SPAN(joint.upper_rad).shown}"
        sensor, kind = joint.sensor, _sensor(joint)
        sigma = "" if isinstance(sensor, NoSensor) else units.READING_SD(sensor.sigma_rad).shown
        offset = "found" if f"theta_off_{j}" in free else "as the file has it"
        rows.append([str(j), joint.name, span, kind, sigma, offset])
    others = ", ".join(e.name for e in arm.free if e.kind is not DhKind.THETA_OFF)
    parallel = ", ".join(map(str, arm.hayati_rows))
    length = units.LENGTH_TOLERANCE(max(arm.length_tolerance_m)).with_unit
    twist = units.ANGLE_TOLERANCE(max(arm.twist_tolerance_rad)).with_unit
    lines = [f"Arm {arm.name}", aligned(rows, left=True)]
    if others:
        lines.append(paragraph(f"Free in addition to the offsets: {others}."))
    known = f"Tolerances in the file: lengths {length}, twists {twist} (the largest of all rows)."
    lines.append(paragraph(known))
    if parallel:
        lines.append(f"Parallel axes in D-H row {parallel}: beta (Hayati) is used in place of s.")
    if arm.assumed:
        assumed = f"Assumed, as the file does not state it: {', '.join(arm.assumed)}."
        lines.append(paragraph(assumed))
    return "\n".join(lines)


def _sensor(joint: Joint) -> str:
    match joint.sensor:
        case Encoder() as encoder:
            return f"encoder, {encoder.counts_per_rev} counts per turn"
        case Rvdt() as rvdt:
            return f"RVDT, {rvdt.bits} bits over {units.SPAN(rvdt.full_scale_rad).with_unit}"
        case _:
            return "none: the loop measures its angle, and no drive can hold it"


def _chain(chain: Chain) -> str:
    arm, spec, feasibility = chain.arm, chain.fixture, chain.feasibility
    give, tolerance = spec.fixture.compliance, spec.fixture.tolerance
    yields = [units.DEFLECTION_LENGTH(give.position_m).with_unit] if give.position_m else []
    if give.orientation_rad and spec.kind != "ball":
        yields.append(units.DEFLECTION_ANGLE(give.orientation_rad).with_unit)
    deflection = f"; under load it deflects by {' and '.join(yields)}" if yields else ""
    immobile = {c.joint for c in feasibility.checks if c.kind is CheckKind.IMMOBILE}
    checks = [c for c in feasibility.checks if c.severity is not Severity.OK]
    blind = [d for d in feasibility.unidentifiable if immobile.isdisjoint(d.immobile_joints)]
    warnings = [] if feasibility.refusal is None else [str(feasibility.refusal)]
    warnings += [f"{c.severity.value}: {c.text}: {c.remedy}" for c in checks]
    warnings += [f"not identifiable: {d}" for d in blind]
    lines = [
        f"{arm.name} in {spec.name}",
        paragraph(
            f"The tolerance of the {spec.kind}'s placement is "
            f"{units.LENGTH_TOLERANCE(tolerance.position_m).with_unit} and "
            f"{units.ANGLE_TOLERANCE(tolerance.orientation_rad).with_unit}{deflection}."
        ),
        *map(paragraph, _freedom(chain)),
        paragraph(
            f"{plural(len(feasibility.parameters), 'parameter')} would be identified: "
            f"{', '.join(p.name for p in feasibility.parameters)}."
        ),
        *map(warning, warnings),
        *_other_home(chain),
        *(paragraph(f"{name} is fixed: {reason}.") for name, reason in chain.held.items()),
    ]
    region = feasibility.identifiability
    if region is not None and not feasibility.refused:
        lines.append(_identifiability_text("Poses over the whole reachable region", region))
    for file, identifiability in chain.poses:
        lines.append(_identifiability_text(f"The poses of {file}", identifiability))
        lines += [warning(f"not identifiable: {d}") for d in identifiability.directions]
    lines += [warning(f"{file}: {reason}") for file, reason in chain.unfit]
    return "\n".join(lines)


def _freedom(chain: Chain) -> list[str]:
    feasibility, n = chain.feasibility, chain.arm.joint_count
    if feasibility.mobility is None:
        return []
    mobility = feasibility.mobility
    lines = [
        f"Mobility {mobility}: exactly {plural(mobility, 'joint')} in position mode{others_free(mobility, n)}."
        if chain.fixture.fixture.holds_hand
        else f"The tool is free: all {n} joints in position mode."
    ]
    if feasibility.choice is not None:
        chosen = f"{joints_named(feasibility.choice.drives).capitalize()} would drive"
        lines.append(f"{chosen} ({'; '.join(feasibility.choice.reasons)}).")
    if feasibility.home_to_closed_rad is not None:
        distance = abs(feasibility.home_to_closed_rad)
        j = int(distance.argmax())
        lines.append(
            f"From home_deg to the nearest pose that closes: {units.DEVIATION(float(distance[j])).with_unit} at most, "
            f"joint {j + 1}."
        )
    return lines


def _other_home(chain: Chain) -> list[str]:
    if chain.home is None:
        return []
    home, feasibility = chain.home
    lines = [
        warning(
            f"This home pose is usable, and closes with the {chain.fixture.kind}: write it into the file of "
            f"{chain.arm.name}, bring the arm there, and check again:"
        ),
        f"  home_deg: [{', '.join(f'{a:g}' for a in short_degrees(home))}]",
    ]
    if feasibility.identifiability is not None:
        region = "Poses over the whole region reachable from there"
        lines.append(_identifiability_text(region, feasibility.identifiability))
    return lines


def _identifiability_text(what: str, identifiability: Identifiability) -> str:
    if identifiability.directions:
        rank = identifiability.rank
        return paragraph(f"{what} determine only {rank} combinations of the parameters.")
    condition = units.CONDITION(identifiability.scaled_condition_number).shown
    weakest = ", ".join(identifiability.weakest.parameters[:4])
    return paragraph(
        f"{what} determine all of them; scaled condition number {condition}, weakest: {weakest}."
    )


def check_json(files: FilesRead, chains: Sequence[Chain]) -> dict[str, Any]:
    """Return the JSON object: files, problems, and the calibration forecast of each arm in its fixture."""
    return {
        "files": [
            {
                "file": f.source.file,
                "kind": f.kind,
                "text": _file_text(f),
                "warnings": [asdict(w) for w in _warnings(f)],
            }
            for f in files.files
        ],
        "problems": [asdict(problem) for problem in files.problems],
        "chains": [_chain_data(chain) for chain in chains],
    }


def _chain_data(chain: Chain) -> dict[str, Any]:
    feasibility, arm, choice = chain.feasibility, chain.arm, chain.feasibility.choice
    sensors: dict[type, str] = {Encoder: "encoder", Rvdt: "rvdt", NoSensor: "none"}
    return {
        "procedure": chain.procedure or None,
        "arm": arm.name,
        "fixture": chain.fixture.name,
        "kind": chain.fixture.kind,
        "joints": [
            {"joint": k, "name": joint.name, "sensor": sensors[type(joint.sensor)]}
            for k, joint in enumerate(arm.joints, 1)
        ],
        "mobility": feasibility.mobility,
        "drives": choice and {"joints": list(choice.drives), "reasons": list(choice.reasons)},
        "home_deg": None if chain.home is None else short_degrees(chain.home[0]),
        "refusal": None if feasibility.refusal is None else str(feasibility.refusal),
        "checks": [c.data for c in feasibility.checks],
        "parameters": [p.name for p in feasibility.parameters],
        "held": dict(chain.held),
        "seen": _identifiability_data(feasibility.identifiability),
        "poses": {file: _identifiability_data(of_poses) for file, of_poses in chain.poses},
        "unfit": dict(chain.unfit),
        "assumed": list(arm.assumed),
    }


def _identifiability_data(identifiability: Identifiability | None) -> dict[str, Any] | None:
    if identifiability is None:
        return None
    return {
        "rank": identifiability.rank,
        "scaled_condition_number": Figure(identifiability.scaled_condition_number).in_json,
        "not_identifiable": [
            {"parameters": list(d.parameters), "text": str(d)} for d in identifiability.directions
        ],
    }
