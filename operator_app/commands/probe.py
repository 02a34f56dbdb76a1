"""`sarcal probe`: lists the nodes on a bus and their differences from a bus profile, or drafts a profile."""

import argparse
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hardware.buses.python_can import open_bus
from hardware.buses.shared_bus import SharedBus
from hardware.commissioning.probe import Probe, probe
from hardware.commissioning.profile_draft import DraftRefused, draft
from operator_app.commands.choices import bus_of_others
from operator_app.composition import print_recording_problem
from operator_app.config.any_file import save_with_schema, schema_line
from operator_app.config.procedure import DEFAULT_PROFILE
from operator_app.config.profile_file import format_profile, load_profile
from operator_app.config.resources import exists
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.report.text import aligned
from operator_app.safe_output import as_json, say

CHECK = """\
Made by `sarcal probe`; nothing was moved. Check what a drive cannot report before anything is enabled:
- Joints are numbered in the order of their nodes. Renumber them if the arm has another order.
- Direction: turn each joint by hand, and probe before and after. If its 6064h falls while its angle grows
  in the arm file's sense, add direction: -1.
- If the position units of a drive are not those of the arm file's sensor, add counts_per_rev.
- {maps}
- Does each drive hold when the operator's heartbeat (node 127) is lost (1016h)? `sarcal arm-check` tests it."""
"""Comment at the top of a draft."""
MAPS = {
    False: "A drive with other PDOs is refused. To write these PDOs into the drives at every connection, "
    "before\n  anything is enabled, and without storing them there: pdo_maps: configured",
    True: "These PDOs are written into the drives at every connection, before anything is enabled, and\n"
    "  not stored in them (pdo_maps: configured). The first connection shows whether the drives accept them.",
}
"""Text on the PDOs of a draft, by whether ``--configure`` is given."""


def execute(args: argparse.Namespace) -> int:
    """Probe the bus and print the result; exit 3 if no node answers or a problem was found."""
    if args.configure and args.draft is None:
        raise UsageError("--configure needs --draft FILE")
    settings = bus_of_others(args)
    if args.draft is not None and exists(args.draft):
        raise UsageError(f"--draft: {args.draft} exists; name another file")
    profile = load_profile(args.profile or DEFAULT_PROFILE)
    result = probe(wire := SharedBus(open_bus(settings), record_to=args.record), profile)
    print_recording_problem(args.record, wire.recording_failure)
    if args.draft is not None:
        return _draft(args, result)
    problems = [*result.unanswering, *(text for node in result.nodes for text in node.problems)]
    if result.meanwhile:
        problems.insert(0, f"{result.meanwhile}: end that program, then probe again")
    fine = bool(result.nodes) and not problems
    if args.json:
        say(as_json(probe_json(result)))
    elif not _report_no_nodes(result, str(settings)):
        rows = [
            [
                str(node.node),
                node.device_name or "-",
                f"{node.device_type:08X}h",
                "-" if node.serial_number is None else str(node.serial_number),
                "-" if node.position_counts is None else str(node.position_counts),
                "differs" if node.problems else "as expected",
            ]
            for node in result.nodes
        ]
        header = ["node", "device", "type (1000h)", "serial", "6064h (counts)", "state"]
        say(aligned([header, *rows]))
        for line in (*problems, *(note for node in result.nodes for note in node.notes)):
            say(line)
        say("Nothing was enabled and nothing has moved.")
    return ExitCode.ACCEPTED if fine else ExitCode.ARM_FAULT


def probe_json(result: Probe) -> dict[str, Any]:
    """Return a probe as JSON data. Each node has a list of its valid PDOs (``pdos``) and a JSON object ``room``.

    ``room`` has the data for drafting a bus profile: numbers of all PDOs that the node receives ("taken") and sends
    ("sent"), and the width in bits of each object that the PDOs must carry ("bits").
    """
    data = asdict(result)
    for node, shown in zip(result.nodes, data["nodes"], strict=True):
        shown["pdos"] = [
            {key: value for key, value in asdict(pdo).items() if key != "valid"}
            for pdo in node.pdos
            if pdo.valid
        ]
        del shown["widths"]
        shown["room"] = {
            "taken": [pdo.number for pdo in node.pdos if not pdo.sent],
            "sent": [pdo.number for pdo in node.pdos if pdo.sent],
            "bits": list(node.widths.items()),
        }
    return data


def _report_no_nodes(result: Probe, bus: str) -> bool:
    if result.busy:
        heard = ", ".join(map(str, result.heard)) or "none"
        say(
            f"sarcal: {result.busy}. No node was probed. End that program, then probe again. "
            f"Heartbeats of nodes: {heard}.",
            err=True,
        )
    elif not result.nodes:
        why = "; ".join(result.unanswering) or "Check power, cable and bitrate"
        say(f"sarcal: no node answers on {bus}. {why}.", err=True)
    return bool(result.busy) or not result.nodes


def _draft(args: argparse.Namespace, result: Probe) -> int:
    if _report_no_nodes(result, "this bus"):
        return ExitCode.ARM_FAULT
    unsure = [p for node in result.nodes for p in node.problems if "two devices" in p]
    if result.meanwhile:
        unsure.append(result.meanwhile)
    try:
        if unsure:
            raise DraftRefused(unsure)
        made = draft(result.nodes, name=_name(args.draft), configure=args.configure)
    except DraftRefused as none:
        for reason in none.reasons:
            say(f"sarcal: {reason}", err=True)
        otherwise = ", or have them set up at every connect: --configure"
        if args.configure or unsure:
            otherwise = ""
        say(f"sarcal: no profile was written. Set these up{otherwise}, then probe again.", err=True)
        return ExitCode.ARM_FAULT
    heading = f"{schema_line('profile')}\n{CHECK.format(maps=MAPS[args.configure])}"
    if silent := ", ".join(str(node.node) for node in result.nodes if node.notes):
        heading += f"\n  Not known for nodes without 1016h: {silent}."
    content = format_profile(made, comment=heading)
    save_with_schema(args.draft, content, "profile")
    for line in result.unanswering:
        say(f"sarcal: not in the profile: {line}.", err=True)
    if args.json:
        say(as_json({**probe_json(result), "draft": str(args.draft)}))
        return ExitCode.ACCEPTED
    joints = ", ".join(f"joint {j} = node {node}" for j, node in enumerate(made.drives, 1))
    keeper = "no supervisor" if made.supervisor is None else f"supervisor = node {made.supervisor}"
    say(
        f"{args.draft}: {joints}; {keeper}.\n"
        "Nothing was enabled and nothing has moved. Read its first lines, check them on the arm, then go on "
        f"with: sarcal arm-check --profile {args.draft}"
    )
    return ExitCode.ACCEPTED


def _name(file: Path) -> str:
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", file.stem)[:64]
    return name if re.match(r"[A-Za-z]", name) else f"profile_{name}"[:64]
