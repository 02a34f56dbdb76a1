"""The procedure, bus and virtual arm that a session names. Opens nothing; loads a bus only when asked for one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hardware.virtual import DEFAULT_SCENARIO

if TYPE_CHECKING:
    from hardware.buses.python_can import BusSettings
    from hardware.virtual.scenarios import Scenario
    from operator_app.config.procedure import Procedure
    from operator_app.session.workflow.opening import Choices, Opening


def carried_procedure(opening: Opening) -> Procedure:
    """Return the procedure with the arm that is really there: a virtual one may carry other sensors."""
    procedure, choices = opening.procedure, opening.choices
    if opening.imported:
        return procedure
    # A session says which bus it had; whether that can be opened here is nothing to a report of it.
    interface = choices.interface or session_bus(choices, procedure).interface
    if interface != "virtual" and choices.scenario is None:
        return procedure
    return replace(procedure, arm=named_scenario(choices).arm(procedure.arm))


def named_scenario(choices: Choices) -> Scenario:
    """Return the scenario these choices name, whatever arm it is of."""
    from hardware.virtual.scenarios import scenario

    return scenario(choices.scenario or DEFAULT_SCENARIO, choices.seed or 0)


def session_bus(choices: Choices, procedure: Procedure) -> BusSettings:
    """Command line over procedure file over environment and can.conf over the user's settings."""
    from hardware.buses.python_can import bus_settings
    from operator_app.config.user_settings import usual_bus

    from_file = procedure.bus
    interface = choices.interface
    if interface is None and from_file.interface != "virtual":
        interface = from_file.interface
    return bus_settings(
        interface,
        choices.channel or from_file.channel,
        choices.bitrate or from_file.bitrate,
        # Who names a virtual arm means one.
        otherwise=None if choices.scenario or choices.seed is not None else usual_bus(interface),
    )
