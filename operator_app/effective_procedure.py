"""The effective procedure, bus and scenario of a session, without opening the bus."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hardware.virtual import DEFAULT_SCENARIO

if TYPE_CHECKING:
    from hardware.buses.python_can import BusSettings
    from hardware.virtual.scenarios import Scenario
    from operator_app.config.procedure import Procedure
    from operator_app.session.workflow.opening import Choices, Opening


def effective_procedure(opening: Opening) -> Procedure:
    """Return the procedure of a session; a scenario, if there is one, determines the sensors of the arm."""
    procedure, choices = opening.procedure, opening.choices
    if opening.state.imported:
        return procedure
    # The journal states the bus: a report must not depend on whether that bus is available here.
    interface = choices.interface or session_bus(choices, procedure).interface
    if interface != "virtual" and choices.scenario is None:
        return procedure
    return replace(procedure, arm=named_scenario(choices).arm(procedure.arm))


def named_scenario(choices: Choices) -> Scenario:
    """Return the scenario that these choices name, or the default scenario."""
    from hardware.virtual.scenarios import scenario

    return scenario(choices.scenario or DEFAULT_SCENARIO, choices.seed or 0)


def session_bus(choices: Choices, procedure: Procedure) -> BusSettings:
    """Return the bus that one of these states first: command line, procedure, environment, can.conf, user settings."""
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
        # --scenario and --seed select the virtual arm.
        otherwise=None if choices.scenario or choices.seed is not None else usual_bus(interface),
    )
