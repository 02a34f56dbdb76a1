"""What a user always wants (``sarcal/settings/1``): interface, channel, bitrate, theme, operator.

One file in the platform's folder for settings. The command line, a session, a procedure, the environment and
``can.conf`` are all stronger. A file that is wrong is an error and not left out: it may name another bus.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from platformdirs import user_config_path
from pydantic import Field

from operator_app.config.atomic import dump_strict, write_atomically
from operator_app.config.errors import ConfigError, only
from operator_app.config.quantities import Text
from operator_app.config.resources import YAML_LIMIT_BYTES, read_limited
from operator_app.config.schema import StrictRecord, read_model
from operator_app.config.strict_yaml import load_strict

if TYPE_CHECKING:
    from hardware.buses.python_can import BusSettings

FILE_NAME = "settings.yaml"
SETTINGS_SCHEMA = "sarcal/settings/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class UserSettings(StrictRecord):
    """What the file holds; None where it says nothing.

    Attributes
    ----------
    interface, channel, bitrate
        As ``-i``, ``-c`` and ``-b``. Channel and bitrate count where the interface comes from here as well.
    theme
        Of the terminal app.
    operator
        Who works here: kept in the journal of every session.
    """

    interface: Text | None = None
    channel: Text | None = None
    bitrate: Annotated[int, Field(strict=True, ge=10_000, le=8_000_000)] | None = None
    theme: Literal["dark", "light", "none"] | None = None
    operator: Text | None = None

    @property
    def stated(self) -> Mapping[str, object]:
        """What it says, by key."""
        return {key: value for key, value in asdict(self).items() if value is not None}


KEYS = tuple(field.name for field in fields(UserSettings))


def settings_path() -> Path:
    """Return where the file is, or would be."""
    return user_config_path("sarcal", appauthor=False) / FILE_NAME


def load_settings() -> UserSettings:
    """Return the user's settings; without a file, none.

    Raises
    ------
    ConfigError
        The file is wrong: all that is, with line and key.
    """
    data = settings_bytes()
    return parse_settings(data, str(settings_path())) if data is not None else UserSettings()


def settings_if_right() -> tuple[UserSettings, str]:
    """Return the user's settings and a warning. Where the file is wrong, the defaults; the bus does not use these."""
    try:
        return load_settings(), ""
    except ConfigError:
        return UserSettings(), (
            f"{settings_path()} is wrong, so no theme and no operator's name are taken from it: "
            "`sarcal settings` says what is wrong, and mends it"
        )


def settings_bytes() -> bytes | None:
    """Return what the user's file holds, None without one."""
    path = settings_path()
    try:
        if not path.exists():
            return None
    except OSError:
        # A folder that this user may not look into holds no settings of theirs.
        return None
    return read_limited(path, str(path), limit=YAML_LIMIT_BYTES)


def parse_settings(data: bytes, file: str) -> UserSettings:
    """Read the bytes of a settings file; raises ConfigError."""
    return read_model(UserSettings, data, kind="settings", file=file)


def usual_bus(named: str | None = None) -> BusSettings | None:
    """Return the bus that the user's settings name, None where they name none; raises ConfigError.

    Where an interface has been `named` already, or the environment names one, nobody asks them: a wrong file
    does not matter.
    """
    from hardware.buses.python_can import BusSettings

    asked = named is None and not os.environ.get("CAN_INTERFACE")
    usual = load_settings() if asked else UserSettings()
    if usual.interface is None:
        return None
    return BusSettings(
        interface=usual.interface,
        channel=usual.channel or "",
        bitrate=usual.bitrate,
        named_in=str(settings_path()),
    )


def changed(words: Mapping[str, str]) -> UserSettings:
    """Return the user's settings with these keys set, an empty text taking one away.

    A file that is wrong is mended so, key by key; what is no setting can be taken away.

    Raises
    ------
    ConfigError
        A word is no setting, or something is wrong still.
    """
    from hardware.buses.python_can import known_interfaces

    data, file = settings_bytes(), str(settings_path())
    before: dict[str, Any] = {}
    if data:
        document = load_strict(data, file)
        if document.problems:
            raise ConfigError(document.problems)
        before = document.data
    for key, text in words.items():
        if key not in KEYS and (text or key not in before):
            raise only("settings", None, None, f"{key!r} is none", f"one of {', '.join(KEYS)}")
    interface = words.get("interface")
    if interface and interface not in known_interfaces():
        known = ", ".join(known_interfaces())
        raise only(
            "settings", None, None, f"there is no interface {interface!r}", f"one of {known}"
        )
    typed = {k: int(v) if k == "bitrate" and _is_rate(v) else v for k, v in words.items() if v}
    parse_settings(dump_strict({"schema": SETTINGS_SCHEMA, **typed}), "settings")
    kept = {k: v for k, v in before.items() if k not in words and k != "schema"}
    schema = before.get("schema", SETTINGS_SCHEMA)
    try:
        return parse_settings(dump_strict({"schema": schema, **kept, **typed}), file)
    except ConfigError:
        # Told with the lines of the file as it is.
        parse_settings(data or b"", file)
        raise


def _is_rate(text: str) -> bool:
    """Whether it can be a number of bits a second; Python makes no number of thousands of digits."""
    return text.isdecimal() and len(text) < 10


def format_settings(settings: UserSettings) -> bytes:
    """Write them as a file."""
    return dump_strict({"schema": SETTINGS_SCHEMA, **settings.stated})


def save_settings(settings: UserSettings) -> Path:
    """Write the user's file; return where it is."""
    path = settings_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    # Who keeps settings elsewhere links to them.
    write_atomically(path, format_settings(settings), through_link=True)
    return path
