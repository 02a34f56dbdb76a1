"""The rule of section 2.3: exactly as many joints in position mode as the closed chain has freedoms."""

from __future__ import annotations

from operator_app.errors import GuardError


def modes_problem(
    position_joints: tuple[int, ...], *, joint_count: int, mobility: int, kind: str
) -> GuardError | None:
    """Return the error of a wrong set of joints in position mode; None for a right one."""
    have = len(set(position_joints))
    wrong = [j for j in position_joints if not 1 <= j <= joint_count]
    if wrong:
        return GuardError(
            f"there is no joint {wrong[0]}", f"joints are numbered 1 to {joint_count}"
        )
    if have == mobility:
        return None
    names = ", ".join(str(j) for j in sorted(set(position_joints))) or "none"
    fact = (
        f"{have} joint{'s' if have != 1 else ''} in position mode ({names}) where "
        + ("an open arm leaves" if mobility == joint_count else f"a {kind} fixture leaves")
        + f" the arm {mobility} freedom{'s' if mobility != 1 else ''}"
    )
    consequence = (
        "the other joints would not be held, and the arm would sag"
        if have < mobility
        else "they would work against each other through the fixture, and torque would build up "
        "until a drive trips"
    )
    return GuardError(f"{fact}: {consequence}", f"put exactly {mobility} in position mode")


def and_the_others(driven: int, joint_count: int) -> str:
    """Return ", the others free", or "" if all joints drive."""
    return "" if driven == joint_count else ", the others free"
