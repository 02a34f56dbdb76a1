"""Draws the manual's figures. Run: python -m tests.figures

The loop of the packaged arm in the packaged hinge, and the share of each error source in the variance of each
parameter, of a calibration of 40 simulated poses.
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

TABLE = "table: holds the arm's base and one half of the hinge"
FIGURES = Path(__file__).parents[2] / "operator_app/manual/pages/figures"
TEXT_COLOUR, GREY, BACKGROUND = "#16181a", "#5a6269", "#f4f5f6"
COLOURS = ("#004f8c", "#c46a00", "#2f7d4f", "#8a3ffc", "#8f1d00", "#6b7480")
SOURCES: Mapping[str, tuple[str, ...]] = {
    "lengths": ("lengths",),
    "twists": ("twists",),
    "fixture": ("fixture_give",),
    "RVDTs": ("rvdt_curve_6", "rvdt_curve_7", "rvdt_gain_6", "rvdt_gain_7"),
    "joints, encoders": ("encoder_accuracy", "joint_play", "sag"),
    "resolution, noise": ("counts", "rvdt_noise_6", "rvdt_noise_7"),
}


def svg(width: float, height: float, title: str, parts: Iterable[str]) -> str:
    """Return a figure with a background, legible on a dark page too."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">'
    card = f'<rect width="{width:g}" height="{height:g}" rx="8" fill="{BACKGROUND}"/>'
    style = "<style>text{font:13px system-ui,sans-serif}</style>"
    return "\n".join([head, f"<title>{escape(title)}</title>", style, card, *parts, "</svg>", ""])


def text(
    x: float, y: float, words: str, *, anchor: str = "start", colour: str = TEXT_COLOUR
) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" text-anchor="{anchor}">{escape(words)}</text>'


def line(a: np.ndarray, b: np.ndarray, colour: str, width: float, dash: str = "") -> str:
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" stroke="{colour}" '
        f'stroke-width="{width:g}" stroke-linecap="round"{dashed}/>'
    )


def loop() -> str:
    """Draw the arm at home, its hinge, and the table, in the app's projection."""
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    model = fixture.model(arm)
    polyline = model.drawn(nominal_vector(model.parameters), arm.home_rad)
    assert polyline is not None
    points, axis = polyline
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
        line(np.array([40.0, floor]), np.array([560.0, floor]), GREY, 4.0),
        text(560.0, floor + 20.0, TABLE, anchor="end"),
        line(hinge, np.array([hinge[0], floor]), GREY, 3.0, "2 7"),
        line(base, np.array([base[0], floor]), GREY, 3.0, "2 7"),
        line(hinge - 55.0 * along, hinge + 55.0 * along, COLOURS[1], 2.0, "7 4"),
        text(hinge[0] + 14.0, hinge[1] + 22.0, "hinge: its angle is not sensed", colour=COLOURS[1]),
    ]
    for a, b in pairwise(flat):
        parts.append(line(a, b, COLOURS[0], 6.0))
    labels: dict[tuple[int, int], list[str]] = {}
    for joint, point in enumerate(flat[:-1], 1):
        labels.setdefault((round(point[0]), round(point[1])), []).append(str(joint))
    for (x, y), joints in labels.items():
        parts.append(
            f'<circle cx="{x}" cy="{y}" r="7" fill="{BACKGROUND}" stroke="{COLOURS[0]}" stroke-width="3"/>'
        )
        parts.append(text(x - 12.0, y - 10.0, ", ".join(joints), anchor="end"))
    return svg(620.0, floor + 40.0, "The closed chain: table, arm, tool, hinge, table", parts)


def budget() -> str:
    """Draw a bar for each parameter, with the shares of the error sources."""
    simulated = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=0)
    result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=simulated.poses)
    shares = result.to_json()["budget"]
    left, width, step = 110.0, 480.0, 24.0
    parts = []
    for k, (name, share) in enumerate(shares.items()):
        y, x = 16.0 + step * k, left
        parts.append(text(left - 8.0, y + 14.0, name, anchor="end"))
        total = sum(max(0.0, v) for v in share.values())
        for colour, names in zip(COLOURS, SOURCES.values(), strict=True):
            w = width * sum(max(0.0, share.get(n, 0.0)) for n in names) / total
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="18" fill="{colour}"/>'
            )
            x += w
    y = 16.0 + step * len(shares) + 12.0
    for tick in (0, 25, 50, 75, 100):
        parts.append(
            text(left + width * tick / 100.0, y, f"{tick} %", anchor="middle", colour=GREY)
        )
    for k, (colour, name) in enumerate(zip(COLOURS, SOURCES, strict=True)):
        x, row = left + 165.0 * (k % 3), y + 14.0 + 22.0 * (k // 3)
        parts.append(f'<rect x="{x:.1f}" y="{row:.1f}" width="12" height="12" fill="{colour}"/>')
        parts.append(text(x + 18.0, row + 11.0, name))
    title = "Share of each source of error in the variance of each parameter"
    return svg(620.0, y + 66.0, title, parts)


def main() -> None:
    FIGURES.mkdir(exist_ok=True)
    for name, figure in (("loop", loop()), ("budget", budget())):
        (FIGURES / f"{name}.svg").write_text(figure)
        print(f"figures/{name}.svg")


if __name__ == "__main__":
    main()
