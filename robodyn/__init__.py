"""robodyn: dynamics of planar mechanisms, from arms to linkages with closed loops.

    mech = robodyn.load("2r")
    tau = robodyn.inverse_dynamics(mech, q, qd, qdd)

Names are imported when they are first used, so that `import robodyn` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robodyn.control.laws import controller as controller
    from robodyn.control.state_feedback import StateFeedback as StateFeedback
    from robodyn.control.tracking import ReferenceTable as ReferenceTable
    from robodyn.dynamics.closed_form import coriolis_matrix as coriolis_matrix
    from robodyn.dynamics.closed_form import gravity_vector as gravity_vector
    from robodyn.dynamics.closed_form import kinetic_energy as kinetic_energy
    from robodyn.dynamics.closed_form import mass_matrix as mass_matrix
    from robodyn.dynamics.closed_form import other_forces as other_forces
    from robodyn.dynamics.closed_form import potential_energy as potential_energy
    from robodyn.dynamics.derivatives import (
        forward_dynamics_derivatives as forward_dynamics_derivatives,
    )
    from robodyn.dynamics.derivatives import (
        inverse_dynamics_derivatives as inverse_dynamics_derivatives,
    )
    from robodyn.dynamics.dynamics import coupling_torques as coupling_torques
    from robodyn.dynamics.dynamics import forward_dynamics as forward_dynamics
    from robodyn.dynamics.dynamics import forward_dynamics_and_forces as forward_dynamics_and_forces
    from robodyn.dynamics.dynamics import inverse_dynamics as inverse_dynamics
    from robodyn.dynamics.dynamics import inverse_dynamics_and_forces as inverse_dynamics_and_forces
    from robodyn.dynamics.dynamics import kept_moments as kept_moments
    from robodyn.dynamics.dynamics import pin_forces as pin_forces
    from robodyn.dynamics.named_points import points as points
    from robodyn.dynamics.reaction_forces import reactions as reactions
    from robodyn.dynamics.reaction_forces import shaking_force as shaking_force
    from robodyn.dynamics.reaction_forces import slide_moments as slide_moments
    from robodyn.dynamics.state import State as State
    from robodyn.dynamics.state import motor_loads as motor_loads
    from robodyn.errors import AssemblyError as AssemblyError
    from robodyn.errors import DescriptionError as DescriptionError
    from robodyn.errors import InputError as InputError
    from robodyn.errors import ResidualError as ResidualError
    from robodyn.errors import RobodynError as RobodynError
    from robodyn.errors import SingularError as SingularError
    from robodyn.loops.public import assemble as assemble
    from robodyn.loops.public import closure_gap as closure_gap
    from robodyn.loops.public import closure_jacobian as closure_jacobian
    from robodyn.loops.public import loop_accelerations as loop_accelerations
    from robodyn.loops.public import loop_velocities as loop_velocities
    from robodyn.mechanics.mechanism import Mechanism as Mechanism
    from robodyn.mechanics.voltages import voltages as voltages
    from robodyn.notebook.figures_of import animate as animate
    from robodyn.notebook.figures_of import draw as draw
    from robodyn.notebook.figures_of import plot as plot
    from robodyn.notebook.loading import load as load
    from robodyn.notebook.sweep_table import sweep as sweep
    from robodyn.parameters.identification import identify as identify
    from robodyn.parameters.motion_fit import fit as fit
    from robodyn.parameters.motion_fit import fit_motion as fit_motion
    from robodyn.parameters.regression_matrix import regressor as regressor
    from robodyn.rest.linear_model import linearize as linearize
    from robodyn.rest.linear_model import lqr as lqr
    from robodyn.rest.poses_at_rest import equilibria as equilibria
    from robodyn.rest.poses_at_rest import equilibrium as equilibrium
    from robodyn.runs.simulation import Motion as Motion
    from robodyn.runs.simulation import simulate as simulate
    from robodyn.trajectories.postures import Posture as Posture
    from robodyn.trajectories.postures import postures as postures
    from robodyn.trajectories.reference import ReferenceMotion as ReferenceMotion
    from robodyn.trajectories.reference import reference_motion as reference_motion
    from robodyn.trajectories.task_space import inverse_kinematics as inverse_kinematics
    from robodyn.trajectories.time_scaling import shortest_motion as shortest_motion

__version__ = "0.1.0"

_ROOMS = {
    "dynamics.closed_form": [
        "coriolis_matrix",
        "gravity_vector",
        "kinetic_energy",
        "mass_matrix",
        "other_forces",
        "potential_energy",
    ],
    "control.laws": ["controller"],
    "dynamics.derivatives": ["forward_dynamics_derivatives", "inverse_dynamics_derivatives"],
    "dynamics.dynamics": [
        "coupling_torques",
        "forward_dynamics",
        "forward_dynamics_and_forces",
        "inverse_dynamics",
        "inverse_dynamics_and_forces",
        "kept_moments",
        "pin_forces",
    ],
    "errors": [
        "AssemblyError",
        "DescriptionError",
        "InputError",
        "ResidualError",
        "RobodynError",
        "SingularError",
    ],
    "dynamics.named_points": ["points"],
    "loops.public": [
        "assemble",
        "closure_gap",
        "closure_jacobian",
        "loop_accelerations",
        "loop_velocities",
    ],
    "mechanics.mechanism": ["Mechanism"],
    "dynamics.state": ["State", "motor_loads"],
    "mechanics.voltages": ["voltages"],
    "dynamics.reaction_forces": ["reactions", "shaking_force", "slide_moments"],
    "notebook.figures_of": ["animate", "draw", "plot"],
    "notebook.loading": ["load"],
    "notebook.sweep_table": ["sweep"],
    "parameters.identification": ["identify"],
    "parameters.regression_matrix": ["regressor"],
    "parameters.motion_fit": ["fit", "fit_motion"],
    "rest.poses_at_rest": ["equilibria", "equilibrium"],
    "rest.linear_model": ["linearize", "lqr"],
    "runs.simulation": ["Motion", "simulate"],
    "control.state_feedback": ["StateFeedback"],
    "control.tracking": ["ReferenceTable"],
    "trajectories.task_space": ["inverse_kinematics"],
    "trajectories.postures": ["Posture", "postures"],
    "trajectories.time_scaling": ["shortest_motion"],
    "trajectories.reference": ["ReferenceMotion", "reference_motion"],
}
_ROOM_OF = {name: room for room, names in _ROOMS.items() for name in names}
__all__ = sorted(_ROOM_OF)


def __getattr__(name: str) -> object:
    if name not in _ROOM_OF:
        raise AttributeError(f"module 'robodyn' has no attribute '{name}'")
    value = getattr(import_module(f"robodyn.{_ROOM_OF[name]}"), name)
    if isinstance(value, FunctionType):
        value = _checked(value)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def _checked(function: FunctionType) -> FunctionType:
    """The function, which refuses arguments that are not what their annotations say."""
    from functools import wraps

    from robodyn.arguments import argument_check
    from robodyn.errors import InputError
    from robodyn.mechanics.mechanism import Mechanism

    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    room = function.__module__.split(".")[1]
    at_states = "qd" in names and room in ("dynamics", "loops")
    check = argument_check(function)

    @wraps(function)
    def checked(*given: Any, **named: Any) -> Any:
        first = given[0] if given else named.get("mechanism")
        if names[:1] == ("mechanism",) and (given or named) and not isinstance(first, Mechanism):
            told = repr(first) if isinstance(first, (str, bytes)) else type(first).__name__
            limit = "must be a Mechanism, which robodyn.load makes of a file or a name"
            raise InputError("mechanism", where=function.__name__, value=told, limit=limit)
        check(given, named)
        if at_states:
            from robodyn.mechanics.placed import within_floats

            return within_floats(function, names, given, named)
        return function(*given, **named)

    checked.__module__ = "robodyn"  # where others find it, as pickles do
    return checked  # type: ignore[return-value]
