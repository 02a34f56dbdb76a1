"""`sarcal export`: writes or uploads the parameters of a session."""

import argparse
import sys
from dataclasses import asdict

from operator_app.commands.choices import choices_from, recording
from operator_app.commands.options import FORMATS
from operator_app.config.atomic import write_atomically
from operator_app.config.parameters_file import format_parameters
from operator_app.config.resources import DESCRIPTION_LIMIT_BYTES, read_limited
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.report.exports import EXPORT_FILES, Calibration, in_format, into_description
from operator_app.safe_output import as_json, say
from operator_app.session.store.folders import PARAMETERS_NAME
from operator_app.session.store.parameters_document import parameters_document
from operator_app.session.store.stored_calibration import session_calibration
from operator_app.session.workflow.opening import resume


def execute(args: argparse.Namespace) -> int:
    """Write the session's calibration to a file; with ``--upload``, also upload its parameters to the controller."""
    kind = _format(args)
    if args.upload_now and kind != "yaml":
        raise UsageError(f"--upload: a controller takes the parameters file, not {kind}")
    to_stdout = str(args.output) == "-"
    if args.json and to_stdout:
        raise UsageError("--json: -o - writes to stdout already; name a file")
    chosen = choices_from(args)
    opening = resume(args.session, chosen, root=args.sessions)
    state = opening.state
    if not state.used_poses:
        raise UsageError(f"{opening.folder} has no pose yet: nothing to export.")
    procedure = opening.effective_procedure
    calibration = session_calibration(
        state, procedure, estimator=chosen.estimator, unsensed_joints=chosen.unsensed_joints
    )
    solution = calibration.solution
    if calibration.recalculated_because:
        say(f"sarcal: calibrated again: {calibration.recalculated_because}.", err=True)
    forced = "" if solution.accepted else (args.force or "").strip()
    if not solution.accepted:
        for reason in solution.reasons:
            say(f"sarcal: not accepted: {reason}.", err=True)
        if not forced:
            return ExitCode.NOT_ACCEPTED
    receipt, name = None, PARAMETERS_NAME
    if kind != "yaml":
        what = Calibration(
            solution=solution,
            checks=calibration.checks,
            arm=procedure.arm,
            serial_number=state.serial_number,
            poses=state.pose_set(),
            forced=forced,
        )
        name, data = _converted(args, what, kind)
    elif args.upload_now:
        from operator_app.composition import unattended
        from operator_app.session.workflow.capture import connect
        from operator_app.session.workflow.export import export
        from operator_app.session.workflow.listener import Listener

        # Upload within the session, so that the session's journal records it.
        with unattended(opening, record_to=recording(args, opening)) as session:
            # No drive is enabled, and no instrument of an open arm is needed.
            connect(session, Listener(), measuring=False)
            exported = export(session, solution, upload_too=True, forced=forced)
        data, receipt = exported.parameters.read_bytes(), exported.receipt
    else:
        document = parameters_document(solution, state, procedure, forced=forced)
        data = format_parameters(document)
    target = args.output or opening.folder / name
    if to_stdout:
        sys.stdout.buffer.write(data)
    else:
        write_atomically(target, data)
    if args.json:
        shown = {
            "session": str(opening.folder),
            "format": kind,
            "file": str(target),
            "verdict": solution.verdict.value,
            "forced": forced,
            "serial_number": state.serial_number,
            "uploaded": None if receipt is None else asdict(receipt),
        }
        say(as_json(shown))
    elif not to_stdout:
        say(f"Parameters  {target}")
    if receipt is not None and not args.json:
        say(
            f"Controller  {state.serial_number}: slot {receipt.slot} active, {receipt.length} bytes "
            f"read back, SHA-256 {receipt.sha256}",
            err=to_stdout,
        )
    return ExitCode.ACCEPTED if solution.accepted else ExitCode.NOT_ACCEPTED


def _converted(args: argparse.Namespace, what: Calibration, kind: str) -> tuple[str, bytes]:
    if args.into is None:
        return EXPORT_FILES[kind], in_format(what, kind)
    data = read_limited(args.into, str(args.into), limit=DESCRIPTION_LIMIT_BYTES)
    name = f"{args.into.stem}_calibrated{args.into.suffix}"
    return name, into_description(what, data, args.into.name)


def _format(args: argparse.Namespace) -> str:
    option: str | None = args.format
    if args.into is not None:
        if option not in (None, "urdf"):
            raise UsageError(
                f"--into {args.into}: a description takes the format urdf, not {option}"
            )
        if args.output is not None and args.output.absolute() == args.into.absolute():
            raise UsageError(f"-o {args.output}: it is the file of --into; name another")
        return "urdf"
    ending = args.output.suffix.removeprefix(".").lower() if args.output else ""
    named = "yaml" if ending == "yml" else ending
    if named not in FORMATS:
        if ending and option is None:
            raise UsageError(
                f"-o {args.output}: .{ending} selects no format; end the name in "
                f"{', '.join(f'.{f}' for f in FORMATS)}, or add --format"
            )
        return option or "yaml"
    if option not in (None, named):
        raise UsageError(
            f"-o {args.output} --format {option}: it ends in .{ending}; name one of them"
        )
    return named
