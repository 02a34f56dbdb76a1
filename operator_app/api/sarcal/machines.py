"""`Arm` and `Fixture`, and the functions that read them from files."""

from dataclasses import dataclass, field
from os import PathLike, fspath
from typing import Any, Literal

from numpy.typing import ArrayLike

from operator_app.calibration.calibrated_arm import T_base_flange
from operator_app.config.arm_file import parse_arm
from operator_app.config.fixture_file import FixtureSpec, parse_fixture
from operator_app.config.resources import Resource, resolve
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel

from .calls import readings_rad, shown


@dataclass(frozen=True, slots=True)
class Arm:
    """An arm as described in its file; made by `load_arm`. Arms of the same file and content are equal.

    Attributes
    ----------
    name
        Model name, e.g. ``sarcos_dextrous``.
    source_file
        File from which the arm was read; ``packaged:...`` for a built-in arm.

    Examples
    --------
    >>> import sarcal
    >>> arm = sarcal.load_arm("franka_panda")
    >>> arm
    <sarcal.Arm franka_panda: 7 joints>
    >>> arm.upper_rad.shape
    (7,)
    >>> arm.fk(arm.home_rad).shape
    (4, 4)
    """

    name: str
    source_file: str
    _model: ArmModel = field(repr=False, compare=False)
    _resource: Resource = field(repr=False)

    @property
    def joint_count(self) -> int:
        """Number n of joints."""
        return self._model.joint_count

    @property
    def lower_rad(self) -> FloatArray:
        """Lower ends of the joint ranges, as sensor readings, shape (n,), rad."""
        return self._model.lower_rad

    @property
    def upper_rad(self) -> FloatArray:
        """Upper ends of the joint ranges, as sensor readings, shape (n,), rad."""
        return self._model.upper_rad

    @property
    def home_rad(self) -> FloatArray:
        """Home pose, as sensor readings, shape (n,), rad."""
        return self._model.home_rad

    def fk(self, q_rad: ArrayLike) -> FloatArray:
        """Return the pose of frame n in the arm's base frame, from the uncalibrated values in its file.

        For readings (n,) or (m, n), rad, returns T_base_flange (4, 4) or (m, 4, 4), lengths in m. Raises TypeError or
        ValueError for readings that are not valid for this arm. For the calibrated pose, see `Result.fk`.
        """
        return T_base_flange(self._model.table, readings_rad(q_rad, self._model))

    def __repr__(self) -> str:
        return f"<sarcal.Arm {self.name}: {self.joint_count} joints>"


@dataclass(frozen=True, slots=True)
class Fixture:
    """A fixture as described in its file; made by `load_fixture`.

    Attributes
    ----------
    name, kind
        Name shown to the operator; kind: ``hinge``, ``ball``, ``rigid`` or ``measured``.
    source_file
        File from which the fixture was read; ``packaged:...`` for a built-in fixture.

    Examples
    --------
    >>> import sarcal
    >>> sarcal.load_fixture("ball")
    <sarcal.Fixture ball: a ball>
    """

    name: str
    kind: str
    source_file: str
    _spec: FixtureSpec = field(repr=False, compare=False)
    _resource: Resource = field(repr=False)

    def __repr__(self) -> str:
        return f"<sarcal.Fixture {self.name}: a {self.kind}>"


def load_arm(arm: str | PathLike[str] | Arm) -> Arm:
    """Return the arm in this file, or the built-in arm with this name; an `Arm` is returned unchanged.

    Raises
    ------
    TypeError
        The argument is neither a path, a name nor an `Arm`.
    ConfigError
        The file is invalid; the text lists all problems with line, key and remedy.
    """
    if isinstance(arm, Arm):
        return arm
    resource = resolve("arm", _reference("arm", arm))
    model = parse_arm(resource.data, resource.file)
    return Arm(model.name, resource.file, model, resource)


def load_fixture(fixture: str | PathLike[str] | Fixture) -> Fixture:
    """Return the fixture in this file, or the built-in fixture with this name; raises the same errors as `load_arm`."""
    if isinstance(fixture, Fixture):
        return fixture
    resource = resolve("fixture", _reference("fixture", fixture))
    spec = parse_fixture(resource.data, resource.file)
    return Fixture(spec.name, spec.kind, resource.file, spec, resource)


def _reference(kind: Literal["arm", "fixture"], value: Any) -> str:
    path = fspath(value) if isinstance(value, str | PathLike) else None
    if not isinstance(path, str):
        raise TypeError(
            f"{kind}={shown(value)}: give the path of its file, the name of a built-in {kind}, or what "
            f"sarcal.load_{kind} returned"
        )
    return path
