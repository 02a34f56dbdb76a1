"""Dwells of a recording that became poses, and dwells that were refused, as text and as JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from operator_app.config.dwells import Dwell, RefusedDwell
from operator_app.config.recording import JointRecording, utc_text
from operator_app.units import plural

MOST_LINES = 20


def recording_text(
    recording: JointRecording,
    dwells: Sequence[Dwell],
    refused: Sequence[RefusedDwell],
    *,
    dwell_s: float,
    spread_deg: float,
) -> str:
    """Return one line about the recording, and one line for each of the first `MOST_LINES` refused dwells."""
    span_s = recording.time_s[-1] - recording.time_s[0]
    lost = f" ({recording.left_out} more left out: a joint has no angle, or a time occurs twice)"
    head = (
        f"{recording.file}: {plural(len(dwells), 'pose')} from {len(recording.time_s)} {recording.source}"
        f"{lost if recording.left_out else ''} over {span_s:.1f} s; joints 1 to {len(recording.joints)} are "
        f"{', '.join(recording.joints)}"
    )
    lines = [head]
    for k, stretch in enumerate(refused[:MOST_LINES]):
        began_s = stretch.start_s - recording.time_s[0]
        utc = utc_text(stretch.start_s)
        when = f"{began_s:.2f} s" + (f" ({utc})" if utc else "")
        what, reason = "at rest", f"limit {dwell_s:g} s (--dwell-s)"
        if stretch.joint:
            moves = f"{recording.joints[stretch.joint - 1]} moves by {np.rad2deg(stretch.moved_rad):.3g} deg"
            what, reason = "moving", f"{moves} (limit {spread_deg:g} deg, --spread-deg)"
        lines.append(f"  no pose {k + 1}: {what} for {stretch.seconds:.2f} s at {when}; {reason}")
    if refused[MOST_LINES:]:
        lines.append(f"  and {len(refused) - MOST_LINES} more")
    return "\n".join(lines)


def recording_json(
    recording: JointRecording, dwells: Sequence[Dwell], refused: Sequence[RefusedDwell]
) -> dict[str, Any]:
    """Return the recording's data with all dwells and refused dwells; times in s, as in the recording."""
    return {
        "file": recording.file,
        "joints": list(recording.joints),
        "samples": len(recording.time_s),
        "left_out": recording.left_out,
        "poses": [
            {"start_s": d.start_s, "seconds": d.seconds, "samples": d.samples} for d in dwells
        ],
        "refused": [
            {
                "code": "MOVING" if r.joint else "SHORT",
                "start_s": r.start_s,
                "seconds": r.seconds,
                "joint": r.joint or None,
                "moved_deg": float(np.rad2deg(r.moved_rad)) if r.joint else None,
            }
            for r in refused
        ],
    }
