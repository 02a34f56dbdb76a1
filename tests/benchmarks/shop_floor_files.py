"""The packaged arm and fixture files with other values, as an operator may write them."""

from functools import cache

import numpy as np
import yaml

from operator_app.config.arm_file import parse_arm
from operator_app.config.fixture_file import parse_fixture
from operator_app.config.resources import resolve
from tests.oracles.shop_floor import Sizes


def written(nominal: dict[str, float], stated: Sizes | None = None) -> tuple[bytes, bytes]:
    """Arm and fixture files (YAML) with entries (rad, m) by D-H name, and error sizes if `stated`."""
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
        twist, backlash, sag, accuracy = np.rad2deg(
            [stated.twist_rad, stated.backlash_rad, stated.sag_rad, stated.encoder_rad]
        ).tolist()
        length, position, orientation = (
            1e3 * float(v) for v in (stated.length_m, stated.give_m, stated.give_rad)
        )
        arm["tolerance"] = {"length_mm": length, "twist_deg": twist}
        fixture["give"] = {"position_mm": position, "orientation_mrad": orientation}
        for joint in arm["joints"]:
            joint |= {"backlash_deg": backlash, "sag_deg": sag}
            encoder = joint["sensor"]["kind"] == "encoder"
            joint["sensor"] |= {"accuracy_deg": accuracy} if encoder else {"gain": stated.gain}
    return tuple(yaml.safe_dump(document, sort_keys=False).encode() for document in (arm, fixture))


@cache
def _read(arm: bytes, fixture: bytes):
    return parse_arm(arm, "arm.yaml"), parse_fixture(fixture, "hinge.yaml").fixture


def read(nominal: dict[str, float], stated: Sizes | None = None):
    """Return arm and fixture as they are read from `written`."""
    return _read(*written(nominal, stated))
