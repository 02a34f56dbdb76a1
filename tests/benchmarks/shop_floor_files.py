"""The shipped arm and fixture files with what an operator would have written instead. Judges nothing."""

from functools import cache

import numpy as np
import yaml

from operator_app.config.arm_file import parse_arm
from operator_app.config.fixture_file import parse_fixture
from operator_app.config.resources import resolve
from tests.oracles.shop_floor import Sizes


def written(nominal: dict[str, float], stated: Sizes | None = None) -> tuple[bytes, bytes]:
    """Arm and fixture files (YAML) as an operator may write them.

    Parameters
    ----------
    nominal
        Entries (rad, m) that replace the shipped ones, by D-H name.
    stated
        How large the errors are that the files admit; None leaves what is shipped.
    """
    arm = yaml.safe_load(resolve("arm", "sarcos_dextrous").data)
    fixture = yaml.safe_load(resolve("fixture", "hinge").data)
    for name, value in nominal.items():
        angle = name.startswith(("alpha", "theta_off"))
        number = float(np.rad2deg(value) if angle else 1e3 * value)
        if name.startswith("theta_off"):
            arm["dh"][int(name[-1]) - 1]["theta_off_deg"] = number
        else:
            key = f"{name.replace('_7', '_n')}_{'deg' if angle else 'mm'}"
            assert key in fixture["placement"]
            fixture["placement"][key] = number
    if stated is not None:
        arm["tolerance"] = {
            "length_mm": float(1e3 * stated.length_m),
            "twist_deg": float(np.rad2deg(stated.twist_rad)),
        }
        for joint in arm["joints"]:
            joint["backlash_deg"] = float(np.rad2deg(stated.backlash_rad))
            joint["sag_deg"] = float(np.rad2deg(stated.sag_rad))
            if joint["sensor"]["kind"] == "encoder":
                joint["sensor"]["accuracy_deg"] = float(np.rad2deg(stated.encoder_rad))
            else:
                joint["sensor"]["gain"] = stated.gain
        fixture["give"] = {
            "position_mm": float(1e3 * stated.give_m),
            "orientation_mrad": float(1e3 * stated.give_rad),
        }
    return tuple(yaml.safe_dump(document, sort_keys=False).encode() for document in (arm, fixture))


@cache
def _read(arm: bytes, fixture: bytes):
    return parse_arm(arm, "arm.yaml"), parse_fixture(fixture, "hinge.yaml").fixture


def read(nominal: dict[str, float], stated: Sizes | None = None):
    """Return arm and fixture as they are read from `written`."""
    return _read(*written(nominal, stated))
