"""`robodyn equilibrium`: poses at rest."""

from __future__ import annotations

import numpy as np

from robodyn.cli.options import Model, Q, Tau, option, switch
from robodyn.cli.output import RowOptions, note
from robodyn.cli.progress import progress
from robodyn.cli.states import Quantity, option_source, remarks, single_state
from robodyn.dynamics.columns import column_names, of_joints, result_names, scene_units
from robodyn.errors import named_options
from robodyn.mechanics.mechanism import Mechanism
from robodyn.rest.poses_at_rest import equilibria, searched_turns
from robodyn.rest.poses_at_rest import equilibrium as pose_at_rest

WORDS = {True: "yes", False: "no", None: "undecided"}


def equilibrium(
    model: Model,
    q: Q = None,
    tau: Tau = None,
    hold: list[str] | None = option("A link whose joint stays where it is; repeatable.", "LINK"),
    all: bool = switch("All that are found from many starts."),
    rows: RowOptions = RowOptions(),
) -> None:
    """Where the mechanism rests: near a pose, or everywhere.

    Columns: q1.., the torques tau1.. (N m) that hold the joints of --hold, PE (J), and `stable`:
    yes where PE has a minimum along the closures, no, or undecided where stiffness alone does not
    tell. Without potential it is whether a small motion grows. --q is near the pose, by default the
    scene's start. With --all each pose is told once, the lowest first; where it rests all along a
    motion, hold a joint. Joints with springs are searched over as many turns as their springs
    allow, 10 at most from their free angles; stderr tells the range.

    Dry friction and hard stops hold nothing; loads that vary are those at t = 0.

    \b
    Examples:
      robodyn equilibrium 2r --all
      robodyn equilibrium spring-slider-crank --q -2
      robodyn equilibrium cart-pole --q 0.2,80deg --hold cart
    """
    mechanism = model.load()
    near = None if q is None else single_state(mechanism, [Quantity("q", q)], t=0.0)[0]
    torques = joint_torques(mechanism, tau)
    tell_what_is_left_out(mechanism)
    with remarks(), named_options(["hold", "tau"]):
        if all:
            turns = searched_turns(mechanism, near, hold or (), torques)
            with progress("searching") as watch:
                rests = equilibria(mechanism, near, hold or (), torques, watch)
        else:
            turns, rests = {}, [pose_at_rest(mechanism, near, hold or (), torques)]
    if turns:
        note(f"Note: springs at joints make turns differ: searched {_ranges(mechanism, turns)}")
    held = [k for k, name in enumerate(mechanism.link_names) if name in (hold or ())]
    columns = [*column_names(mechanism, ["q"]), *of_joints("tau", held), "PE"]
    columns += result_names("stable")
    with rows.writer(columns, units=scene_units(mechanism)) as writer:
        for rest in rests:
            values = [*rest.q.tolist(), *rest.tau[held].tolist(), rest.potential_energy]
            writer.write_row([*values, WORDS[rest.stable]])


def _ranges(mechanism: Mechanism, turns: dict[int, tuple[int, int]]) -> str:
    """The angles that were searched, joint by joint."""
    return ", ".join(
        f"q{k + 1} ({mechanism.link_names[k]}) from {360 * low - 180} to {360 * high + 180} deg"
        for k, (low, high) in sorted(turns.items())
    )


def joint_torques(mechanism: Mechanism, tau: str | None) -> np.ndarray:
    """The torques (n,) of --tau, of all joints or the actuated ones."""
    source = option_source(mechanism, Quantity("tau", tau))
    torques = np.zeros(mechanism.n)
    torques[range(mechanism.n) if source.whole else list(mechanism.actuated)] = source.values
    return torques


def tell_what_is_left_out(mechanism: Mechanism) -> None:
    """On stderr what poses at rest do not see, where the scene has any."""
    if mechanism.switches:
        note("Note: dry friction and hard stops hold nothing here")
    if mechanism.timed and mechanism.description.field is None:
        note("Note: loads that vary are those at t = 0")
