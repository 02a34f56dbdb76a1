"""Opens sessions: new ones from a procedure file and options, earlier ones from their journals.

The journal contains the arm, fixture and procedure documents and the bus settings, so that resuming needs neither
files nor environment.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hardware.arm import Recordable
from hardware.virtual import DEFAULT_SCENARIO
from operator_app.config.procedure import MOST_POSES
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.profile_file import parse_profile
from operator_app.config.resources import Kind, Resource, resolve
from operator_app.errors import SessionError
from operator_app.planning.task import require_closed_chain
from operator_app.session.store.folders import find_session, new_folder, next_order
from operator_app.session.store.journal import Clock, Journal, read_journal, utc_now
from operator_app.session.store.journal_format import JOURNAL_NAME
from operator_app.session.store.replay import session_state
from operator_app.session.store.state import SessionState
from operator_app.session.store.stored_calibration import require_estimator_for
from operator_app.session.workflow.remounting import mounting_problem
from solver.estimators.estimate import require_enough_poses

if TYPE_CHECKING:
    from hardware.arm import ArmInterface
    from hardware.buses.python_can import BusSettings
    from hardware.virtual.scenarios import Scenario
    from operator_app.config.procedure import Procedure
    from operator_app.session.store.true_errors import Truths
    from operator_app.session.workflow.pose_reading import Instrument
    from operator_app.session.workflow.session import Session

SOURCE_KINDS: tuple[Kind, ...] = ("procedure", "arm", "fixture", "profile")
"""Kinds of the documents in `Procedure.sources`, in the same order."""

PLANNED_POSES = 12
"""Largest default number of poses of a planned capture that replaces the explored capture of a procedure file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choices:
    """The operator's options, which override the procedure file; an option that is None overrides nothing.

    `interface`, `channel`, `bitrate`: CAN bus.
    `profile`: name or path of the bus profile.
    `scenario`, `seed`: scenario and random seed of the virtual arm.
    `tracker`: port of the instrument.
    `operator`: the operator's name.
    `placements`: number of mountings of the fixture.
    """

    poses: int | None = None
    plan: Literal["explore", "planned"] | None = None
    estimator: Literal["paper", "implicit"] | None = None
    unsensed_joints: tuple[int, ...] | None = None
    length_tolerance_m: float | None = None
    upload: bool | None = None
    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    profile: str | None = None
    scenario: str | None = None
    seed: int | None = None
    tracker: str | None = None
    operator: str | None = None
    placements: int | None = None

    def over(self, earlier: Choices) -> Choices:
        """Return these choices; a choice that is None is taken from `earlier`."""
        own = asdict(self)
        return replace(earlier, **{name: value for name, value in own.items() if value is not None})

    @property
    def virtual_arm(self) -> Scenario:
        """The virtual arm's scenario: `scenario` (by default `DEFAULT_SCENARIO`) with random `seed` (by default 0)."""
        from hardware.virtual.scenarios import scenario

        return scenario(self.scenario or DEFAULT_SCENARIO, self.seed or 0)

    def bus(self, procedure: Procedure) -> BusSettings:
        """Return the bus; in order of priority: choices, procedure, environment, can.conf, user settings."""
        from hardware.buses.python_can import bus_settings
        from operator_app.config.user_settings import usual_bus

        from_file, interface = procedure.bus, self.interface
        if interface is None and from_file.interface != "virtual":
            interface = from_file.interface
        return bus_settings(
            interface,
            self.channel or from_file.channel,
            self.bitrate or from_file.bitrate,
            # --scenario and --seed select the virtual arm.
            otherwise=None if self.scenario or self.seed is not None else usual_bus(interface),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """A session to be started or resumed; nothing is written yet.

    `state`: the state recorded so far; for a new session, only its `sources` are set.
    """

    folder: Path
    resumed: bool
    procedure: Procedure
    choices: Choices
    state: SessionState = field(default_factory=SessionState)

    @property
    def effective_procedure(self) -> Procedure:
        """Procedure whose arm has the virtual arm's sensors if the bus is virtual or a scenario was chosen."""
        procedure, choices = self.procedure, self.choices
        if self.state.imported:
            return procedure
        # The journal states the bus: a report must not depend on whether that bus is available here.
        interface = choices.interface or choices.bus(procedure).interface
        if interface != "virtual" and choices.scenario is None:
            return procedure
        return replace(procedure, arm=choices.virtual_arm.arm(procedure.arm))


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """An arm that is ready to be connected, and the opening of its session.

    `opening`: its `choices`, which the journal records, are complete: the arm, the environment or defaults fill gaps.
    `simulated`: whether the arm is simulated.
    `instrument`: measures the tool of an open arm; None if the loop is closed or no port is specified.
    `truths`: true parameters of an arm simulated in this process; None for any other arm.
    `recording_ended`: function that returns why the recording of the bus ended early, "" if it did not; thread-safe.
    """

    arm: ArmInterface
    opening: Opening
    simulated: bool
    instrument: Instrument | None = None
    truths: Truths | None = None
    recording_ended: Callable[[], str] = str

    @property
    def bus(self) -> str:
        """Name of the bus, for messages to the operator."""
        if self.simulated:
            return "the virtual bus of this program"
        chosen = self.opening.choices
        bitrate = f"{chosen.bitrate} bit/s" if chosen.bitrate else ""
        return " ".join(p for p in (chosen.interface, chosen.channel, bitrate) if p)


def open_session(rig: Rig, *, clock: Clock = utc_now) -> Session:
    """Create the journal, or open the journal of a resumed session; return the session. Raises JournalError."""
    from operator_app.session.workflow.session import Session

    opening, settings = rig.opening, asdict(rig.opening.choices)
    journal = (Journal.resume if opening.resumed else Journal.create)(opening.folder)
    journal.clock = clock
    arm, folder = rig.arm, journal.path.parent
    if isinstance(arm, Recordable) and arm.record_to and arm.record_to.parent == opening.folder:
        # `Journal.create` may have taken the next free folder name: record beside the journal.
        arm.record_to = folder / arm.record_to.name
    try:
        session = Session(rig, journal)
        if opening.resumed:
            session.record("resumed", {"settings": settings})
        else:
            sources, order = dict(opening.state.sources), next_order(folder)
            session.record("opened", {"sources": sources, "settings": settings, "order": order})
    except BaseException:
        journal.close()
        raise
    return session


def remove_if_empty(session: Session) -> bool:
    """Remove the folder of a session that never connected; return whether the folder no longer exists.

    Also removes the parent folders that were created for the session.
    """
    journal = session.journal
    if journal.loss is not None:
        # The folder may belong to another program now.
        return False
    folder = journal.path.parent
    if not folder.is_dir():
        return True
    if session.state.serial_number or [p.name for p in folder.iterdir()] != [JOURNAL_NAME]:
        return False
    (folder / JOURNAL_NAME).unlink()
    folder.rmdir()
    with suppress(OSError):
        for outer in journal.created_folders[1:]:
            outer.rmdir()
    return True


def texts_of(procedure: Procedure) -> dict[str, str]:
    """Return the text of each document of a procedure, by kind."""
    documents = zip(SOURCE_KINDS, procedure.sources, strict=True)
    return {kind: source.data.decode() for kind, source in documents}


def begin(reference: str, choices: Choices, *, root: Path, clock: Clock = utc_now) -> Opening:
    """Return the opening of a new session; `reference`: procedure name or path. Raises ConfigError, SessionError."""
    chosen: dict[Kind, Resource] = {}
    if choices.profile is not None:
        chosen["profile"] = resolve("profile", choices.profile)
    procedure = parse_procedure(resolve("procedure", reference), snapshot=chosen)
    return Opening(
        folder=new_folder(root, procedure.name, clock()),
        resumed=False,
        procedure=_with_choices(procedure, choices),
        choices=choices,
        state=SessionState(sources=texts_of(procedure)),
    )


def resume(reference: str, choices: Choices, *, root: Path) -> Opening:
    """Return the opening of an earlier session; `choices` override the recorded choices. Raises SessionError."""
    folder = find_session(root, reference)
    contents = read_journal(folder)
    state = session_state(contents)
    if state.settings.get("verifies"):
        # An earlier version stored verification poses in a separate session.
        raise SessionError(
            f"{folder} contains poses that verify {state.settings['verifies']}",
            "name that session instead; its poses alone are its calibration",
        )
    # Journals of earlier versions contain no profile.
    if not {"procedure", "arm", "fixture"} <= state.sources.keys():
        raise SessionError(
            f"the journal of {folder} does not contain its procedure",
            "start a new session; its poses can be solved with `sarcal solve`",
        )
    recorded = {
        kind: Resource(file=f"{folder}: {kind}", folder=None, data=state.sources[kind].encode())
        for kind in SOURCE_KINDS
        if kind in state.sources
    }
    procedure = parse_procedure(recorded["procedure"], snapshot=recorded)
    # Check the journal again, now that the number of joints is known.
    session_state(contents, joint_count=procedure.arm.joint_count)
    if choices.profile is not None:
        # The profile defines how counts are converted to angles.
        file = resolve("profile", choices.profile)
        profile = parse_profile(file.data, file.file, joints=procedure.arm.joint_count)
        if profile != procedure.profile:
            raise SessionError(
                f"this session was started with the bus profile {procedure.profile.name}, and {file.file} differs "
                "from it",
                "leave --profile out, or start a new session",
            )
    recorded_choices: dict[str, Any] = {
        f.name: tuple(value) if isinstance(value, list) else value
        for f in fields(Choices)
        if (value := state.settings.get(f.name)) is not None
    }
    before = Choices(**recorded_choices)
    if state.captured:
        for name in ("scenario", "seed"):
            now, then = getattr(choices, name), getattr(before, name)
            if now is not None and then is not None and now != then:
                raise SessionError(
                    f"the poses of this session are of the virtual arm with --{name} {then}, not {now}",
                    "leave the option out, or start a new session",
                )
    merged = choices.over(before)
    procedure = _with_choices(procedure, merged)
    return Opening(folder=folder, resumed=True, procedure=procedure, choices=merged, state=state)


def _with_choices(procedure: Procedure, choices: Choices) -> Procedure:
    capture, plan = procedure.capture, choices.plan
    if plan == "planned" and capture.strategy == "explore":
        # A planned capture needs fewer poses than an explored one.
        capture = replace(capture, poses=min(capture.poses, PLANNED_POSES))
    capture = replace(capture, strategy=plan or capture.strategy)
    if choices.poses is not None:
        if choices.poses > MOST_POSES:
            raise SessionError(
                f"more than {MOST_POSES} poses were requested", f"request at most {MOST_POSES}"
            )
        capture = replace(capture, poses=choices.poses)
    names = ("estimator", "unsensed_joints", "length_tolerance_m", "upload")
    own: dict[str, Any] = {k: v for k in names if (v := getattr(choices, k)) is not None}
    procedure = replace(procedure, capture=capture, **own)
    if choices.placements is not None:
        if problem := mounting_problem(procedure, choices.placements):
            raise problem
        procedure = replace(procedure, placements=choices.placements)
    # Without these checks, a capture could end without a calibration.
    n = procedure.arm.joint_count
    wrong = [j for j in procedure.unsensed_joints if j > n]
    if wrong:
        raise SessionError(f"there is no joint {wrong[0]}", f"joints are 1 to {n}")
    require_estimator_for(procedure.unsensed_joints, procedure.estimator)
    model = procedure.fixture.fixture.model(
        procedure.arm, unsensed_joints=procedure.unsensed_joints
    )
    if procedure.capture.strategy == "planned":
        # The exploration before a plan captures as many poses as are needed.
        require_closed_chain(procedure.fixture.fixture)
    else:
        require_enough_poses(model, procedure.capture.poses)
    return procedure
