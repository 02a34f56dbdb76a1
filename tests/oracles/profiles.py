"""The packaged bus profile."""

from hardware.canopen.bus_profile import BusProfile
from operator_app.config.profile_file import load_profile


def sarcos(joints: int = 7) -> BusProfile:
    return load_profile("sarcos", joints=joints)
