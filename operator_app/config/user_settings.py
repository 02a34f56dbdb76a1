"""What a user always wants (``sarcal/settings/1``): interface, channel, bitrate, theme, operator. Knows no bus.

One file in the platform's folder for settings. The command line, a session, a procedure, the environment and
``can.conf`` are all stronger. A file that is wrong is an error and not left out: it may name another bus.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from platformdirs import user_config_path
from pydantic import Field

from operator_app.config.atomic import write_atomically
from operator_app.config.quantities import Text
from operator_app.config.resources import YAML_LIMIT_BYTES, read_limited
from operator_app.config.schema import StrictRecord, read_model
from operator_app.config.yaml_writer import dump_strict

if TYPE_CHECKING:
    from hardware.buses import BusSettings

FILE_NAME = "settings.yaml"
SCHEMA = "sarcal/settings/1"


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
    path = settings_path()
    try:
        if not path.exists():
            return UserSettings()
    except OSError:
        # A folder that this user may not look into holds no settings of theirs.
        return UserSettings()
    data = read_limited(path, str(path), limit=YAML_LIMIT_BYTES)
    return parse_settings(data, str(path))


def parse_settings(data: bytes, file: str) -> UserSettings:
    """Read the bytes of a settings file; raises ConfigError."""
    return read_model(UserSettings, data, kind="settings", file=file)


def usual_bus() -> BusSettings | None:
    """Return the bus that the user's settings name, None where they name none; raises ConfigError."""
    from hardware.buses import BusSettings

    usual = load_settings()
    if usual.interface is None:
        return None
    return BusSettings(
        interface=usual.interface, channel=usual.channel or "", bitrate=usual.bitrate
    )


def changed(settings: UserSettings, words: Mapping[str, str]) -> UserSettings:
    """Return settings with these keys set, an empty text taking one away; raises ConfigError."""
    typed = {
        key: None if not text else int(text) if key == "bitrate" and _is_rate(text) else text
        for key, text in words.items()
    }
    wanted = replace(settings, **typed)  # type: ignore[arg-type]
    return parse_settings(format_settings(wanted), "settings")


def _is_rate(text: str) -> bool:
    """Whether it can be a number of bits a second; Python makes no number of thousands of digits."""
    return text.isdecimal() and len(text) < 10


def format_settings(settings: UserSettings) -> bytes:
    """Write them as a file."""
    return dump_strict({"schema": SCHEMA, **settings.stated})


def save_settings(settings: UserSettings) -> Path:
    """Write the user's file; return where it is."""
    path = settings_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, format_settings(settings))
    return path
