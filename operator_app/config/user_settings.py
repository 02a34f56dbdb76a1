"""Default settings of a user (``sarcal/settings/1``): interface, channel, bitrate, theme, operator.

They are in one file in the platform's folder for settings. The command line, a session, a procedure, the environment
and ``can.conf`` override them. An invalid file is an error: without its settings, another bus might be used.
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
from operator_app.config.resources import YAML_LIMIT_BYTES, exists, read_limited
from operator_app.config.schema import StrictRecord, read_model
from operator_app.config.strict_yaml import load_strict

if TYPE_CHECKING:
    from hardware.buses.python_can import BusSettings

SETTINGS_SCHEMA = "sarcal/settings/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class UserSettings(StrictRecord):
    """Content of the settings file; None for missing settings.

    `interface`, `channel`, `bitrate`: defaults of ``-i``, ``-c`` and ``-b``; the last two are used only together with
    the interface of this file. `operator`: name that the journal of every session records.
    """

    interface: Text | None = None
    channel: Text | None = None
    bitrate: Annotated[int, Field(strict=True, ge=10_000, le=8_000_000)] | None = None
    theme: Literal["dark", "light", "none"] | None = None
    operator: Text | None = None

    @property
    def stated(self) -> Mapping[str, object]:
        """Settings that the file states, by key."""
        return {key: value for key, value in asdict(self).items() if value is not None}


KEYS = tuple(field.name for field in fields(UserSettings))


def settings_path() -> Path:
    """Return the path of the settings file, which need not exist."""
    return user_config_path("sarcal", appauthor=False) / "settings.yaml"


def load_settings() -> UserSettings:
    """Return the user's settings, all of them None if there is no file; raises ConfigError if the file is invalid."""
    data = _settings_bytes()
    return parse_settings(data, str(settings_path())) if data is not None else UserSettings()


def valid_settings() -> tuple[UserSettings, str]:
    """Return the user's settings and an empty text; if the file is invalid, default settings and a warning.

    Do not take the bus from the result: use `usual_bus`, which raises for an invalid file.
    """
    try:
        return load_settings(), ""
    except ConfigError:
        return UserSettings(), (
            f"{settings_path()} is invalid, and its theme and operator are not used: "
            "`sarcal settings` shows what is wrong; correct or delete the file"
        )


def _settings_bytes() -> bytes | None:
    path = settings_path()
    if not exists(path):
        return None
    return read_limited(path, str(path), limit=YAML_LIMIT_BYTES)


def parse_settings(data: bytes, file: str) -> UserSettings:
    """Read the bytes of a settings file; raises ConfigError."""
    return read_model(UserSettings, data, kind="settings", file=file)


def usual_bus(named: str | None = None) -> BusSettings | None:
    """Return the bus in the user's settings; None if the settings state no interface, or are not read.

    The settings are not read if an interface is `named` or set in the environment. Raises ConfigError for a bad file.
    """
    from hardware.buses.python_can import BusSettings

    applies = named is None and not os.environ.get("CAN_INTERFACE")
    usual = load_settings() if applies else UserSettings()
    if usual.interface is None:
        return None
    return BusSettings(
        interface=usual.interface,
        channel=usual.channel or "",
        bitrate=usual.bitrate,
        named_in=str(settings_path()),
    )


def changed(texts: Mapping[str, str]) -> UserSettings:
    """Return the user's settings with the keys of `texts` set; an empty text removes its key.

    An invalid file can be repaired in this way, key by key, and unknown keys can be removed. Raises ConfigError if a
    key is not a setting, or if the file is still invalid.
    """
    from hardware.buses.python_can import known_interfaces

    data, file = _settings_bytes(), str(settings_path())
    before: dict[str, Any] = {}
    if data:
        document = load_strict(data, file)
        if document.problems:
            raise ConfigError(document.problems)
        before = document.data
    for key, text in texts.items():
        if key not in KEYS and (text or key not in before):
            raise only("settings", f"there is no setting {key!r}", f"one of {', '.join(KEYS)}")
    interface = texts.get("interface")
    if interface and interface not in known_interfaces():
        remedy = f"one of {', '.join(known_interfaces())}"
        raise only("settings", f"there is no interface {interface!r}", remedy)
    typed: dict[str, str | int] = {k: v for k, v in texts.items() if v}
    rate = texts.get("bitrate", "")
    if rate.isdecimal() and len(rate) < 10:  # Python refuses to convert thousands of digits
        typed["bitrate"] = int(rate)
    parse_settings(dump_strict({"schema": SETTINGS_SCHEMA, **typed}), "settings")
    unchanged = {k: v for k, v in before.items() if k not in texts and k != "schema"}
    schema = before.get("schema", SETTINGS_SCHEMA)
    try:
        return parse_settings(dump_strict({"schema": schema, **unchanged, **typed}), file)
    except ConfigError:
        # Reported with the lines of the present file.
        parse_settings(data or b"", file)
        raise


def save_settings(settings: UserSettings) -> Path:
    """Write the settings file, and return its path."""
    path = settings_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    # The file may be a link to settings kept elsewhere.
    data = dump_strict({"schema": SETTINGS_SCHEMA, **settings.stated})
    write_atomically(path, data, through_link=True)
    return path
