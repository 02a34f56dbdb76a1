# ruff: noqa: T201 - says what it wrote
"""The manual's figures, from today's program. Run: python -m tests.figures

The loop as the packaged arm stands in the packaged hinge, and what share of each parameter's variance each
source of error has, of a calibration of 40 simulated poses.
"""

from collections.abc import Iterable, Mapping
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np
import sarcal

from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.parameters import nominal_vector

FIGURES = Path(__file__).parents[2] / "operator_app/manual/pages/figures"
INK, QUIET, PAPER = "#16181a", "#5a6269", "#f4f5f6"
COLOURS = ("#004f8c", "#c46a00", "#2f7d4f", "#8a3ffc", "#8f1d00", "#6b7480")
SOURCES: Mapping[str, tuple[str, ...]] = {
    "lengths": ("lengths",),
    "twists": ("twists",),
    "fixture": ("fixture_give",),
    "RVDTs": ("rvdt_curve_6", "rvdt_curve_7", "rvdt_gain_6", "rvdt_gain_7"),
    "joints, encoders": ("encoder_accuracy", "joint_play", "sag"),
    "resolution, noise": ("counts", "rvdt_noise_6", "rvdt_noise_7"),
}


def svg(width: float, height: float, about: str, parts: Iterable[str]) -> str:
    """A figure on a card of its own, so that it reads on a dark page too."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">'
    card = f'<rect width="{width:g}" height="{height:g}" rx="8" fill="{PAPER}"/>'
    style = "<style>text{font:13px system-ui,sans-serif}</style>"
    return "\n".join([head, f"<title>{escape(about)}</title>", style, card, *parts, "</svg>", ""])


def text(x: float, y: float, said: str, *, anchor: str = "start", colour: str = INK) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" text-anchor="{anchor}">{escape(said)}</text>'


def line(a: np.ndarray, b: np.ndarray, colour: str, width: float, dash: str = "") -> str:
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" stroke="{colour}" '
        f'stroke-width="{width:g}" stroke-linecap="round"{dashed}/>'
    )


def loop() -> str:
    """The arm at home, its hinge, and the table between: seen from the side, as the app draws it."""
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    model = fixture.model(arm)
    drawn = model.drawn(nominal_vector(model.parameters), arm.home_rad)
    assert drawn is not None
    points, axis = drawn
    turn, tilt = np.deg2rad([-60.0, 20.0])
    right = np.array([0.0, np.cos(turn), np.sin(turn)])
    up = np.array([np.cos(tilt), -np.sin(tilt) * np.sin(turn), np.sin(tilt) * np.cos(turn)])
    flat = np.stack([points @ right, -(points @ up)], axis=-1)
    along = np.array([axis @ right, -(axis @ up)])
    scale = 300.0 / np.ptp(flat, axis=0).max()
    flat = (flat - flat.min(axis=0)) * scale + [80.0, 50.0]
    hinge, base = flat[-1], flat[0]
    floor = float(flat[:, 1].max()) + 45.0
    parts = [
        line(np.array([40.0, floor]), np.array([560.0, floor]), QUIET, 4.0),
        text(
            560.0,
            floor + 20.0,
            "table: holds the arm's base and one half of the hinge",
            anchor="end",
        ),
        line(hinge, np.array([hinge[0], floor]), QUIET, 3.0, "2 7"),
        line(base, np.array([base[0], floor]), QUIET, 3.0, "2 7"),
        line(hinge - 55.0 * along, hinge + 55.0 * along, COLOURS[1], 2.0, "7 4"),
        text(hinge[0] + 14.0, hinge[1] + 22.0, "hinge: its angle is not sensed", colour=COLOURS[1]),
    ]
    for a, b in pairwise(flat):
        parts.append(line(a, b, COLOURS[0], 6.0))
    seen: dict[tuple[int, int], list[str]] = {}
    for joint, point in enumerate(flat[:-1], 1):
        seen.setdefault((round(point[0]), round(point[1])), []).append(str(joint))
    for (x, y), joints in seen.items():
        parts.append(
            f'<circle cx="{x}" cy="{y}" r="7" fill="{PAPER}" stroke="{COLOURS[0]}" stroke-width="3"/>'
        )
        parts.append(text(x - 12.0, y - 10.0, ", ".join(joints), anchor="end"))
    return svg(620.0, floor + 40.0, "The closed chain: table, arm, tool, hinge, table", parts)


def budget() -> str:
    """A bar for each parameter, cut into the shares of the sources."""
    made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=0)
    result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=made.poses)
    shares = result.to_json()["budget"]
    left, width, step = 110.0, 480.0, 24.0
    parts = []
    for k, (name, share) in enumerate(shares.items()):
        y, x = 16.0 + step * k, left
        parts.append(text(left - 8.0, y + 14.0, name, anchor="end"))
        whole = sum(max(0.0, v) for v in share.values())
        for colour, names in zip(COLOURS, SOURCES.values(), strict=True):
            w = width * sum(max(0.0, share.get(n, 0.0)) for n in names) / whole
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="18" fill="{colour}"/>'
            )
            x += w
    y = 16.0 + step * len(shares) + 12.0
    for tick in (0, 25, 50, 75, 100):
        parts.append(
            text(left + width * tick / 100.0, y, f"{tick} %", anchor="middle", colour=QUIET)
        )
    for k, (colour, name) in enumerate(zip(COLOURS, SOURCES, strict=True)):
        x, row = left + 165.0 * (k % 3), y + 14.0 + 22.0 * (k // 3)
        parts.append(f'<rect x="{x:.1f}" y="{row:.1f}" width="12" height="12" fill="{colour}"/>')
        parts.append(text(x + 18.0, row + 11.0, name))
    about = "Share of each source of error in the variance of each parameter"
    return svg(620.0, y + 66.0, about, parts)


def main() -> None:
    """Write both."""
    FIGURES.mkdir(exist_ok=True)
    for name, drawn in (("loop", loop()), ("budget", budget())):
        (FIGURES / f"{name}.svg").write_text(drawn)
        print(f"figures/{name}.svg")


if __name__ == "__main__":
    main()
