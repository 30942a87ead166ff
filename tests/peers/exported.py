"""The models that `robodyn export` writes, loaded by the engines, and what constraints do there."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
from bench_frontier import ROOT

import robodyn
from peers.agreement import (
    ROUNDING,
    STATES,
    Compared,
    Row,
    apart,
    compared,
    motion_states,
    product,
    worst,
)
from robodyn.errors import InputError
from robodyn.loops.assembly import loop_size
from robodyn.loops.closures import closure_bias
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text

EXPORTED = (
    *("pendulum", "2r", "3r", "four-bar", "parallelogram", "slider-crank", "five-bar"),
    *("watt-six-bar", "stephenson-six-bar"),
    *("balanced-arm", "geared-five-bar", "spring-slider-crank"),
    *("rp-arm", "scotch-yoke", "whitworth", "hydraulic-boom"),
)
RIG = """
gravity: [1.3, -9.6]
links:
  - {name: plate, m: 2.0, l: 0.5, r: [0.21, 0.13], I: 0.05, payload: 0.4, damping: 0.02}
  - {name: left, m: 0.5, l: 0.3, r: 0.14, I: 0.004, from: {link: plate, at: [0.3, 0.2]}}
  - {name: far hand, m: 0.6, l: 0.4, r: [-0.1, 0], I: 0.007, from: slide, damping: 0.3}
  - {name: slide, m: 0.7, l: 0.9, r: 0.4, I: 0.06, from: [0.4, -0.2], payload: 0.1}
"""
FORCES = """
springs:
  - {between: [far hand, [0.9, 0.5]], stiffness: 40, length: 0.3, damping: 2}
  - {between: [left, {link: slide, at: [0.1, 0.2]}], stiffness: 25, length: 0}
  - {joint: plate, stiffness: 5, angle: 0.4, damping: 0.3}
loads:
  - {link: slide, at: [0.5, 0.1], force: [3, -2]}
  - {link: left, at: [0.2, 0], force: [1, 4], frame: link}
  - {link: far hand, torque: 1.5}
"""
SLIDES = """
gravity: [1.0, -9.81]
links:
  - {name: a, joint: prismatic, axis: [1, 0.5], m: 0.8, l: 0.1, r: [0.03, 0.1], I: 0.002,
     damping: 2}
  - {name: b, m: 0.3, l: 0.4, r: [0.1, 0.02], I: 0.0005, damping: 0.01}
  - {name: c, joint: prismatic, axis: [0, -1], m: 1.5, l: 0.5, r: 0.25, I: 0.03,
     from: {link: b, at: [0.1, 0.2]}, payload: 0.3}
  - {name: d, joint: prismatic, axis: [1, 1], m: 0.7, l: 0.2, r: 0.25, I: 0.02}
  - {name: e, m: 0.3, l: 0.2, r: [0.1, 0.02], I: 0.0005}
"""
SLIDE_FORCES = """
springs:
  - {joint: c, stiffness: 30, length: 0.1, damping: 0.3}
  - {between: [{link: e, at: [0.1, 0.1]}, [0.3, 2]], stiffness: 40, length: 0.4, damping: 1}
loads:
  - {link: d, at: [0.1, 0], force: [3, 1], frame: link}
  - {link: c, torque: 0.4}
"""
MOTORS = """
gravity: [1.3, -9.6]
links:
  - {name: a, m: 2.0, l: 0.5, r: [0.21, 0.13], I: 0.05,
     motor: {ratio: 20, inertia: 1e-4, damping: 1e-5}}
  - {name: b, joint: prismatic, axis: [1, 1], m: 0.7, l: 0.2, r: 0.25, I: 0.02,
     motor: {ratio: 100, inertia: 2e-5}}
  - {name: c, m: 0.3, l: 0.4, r: [0.1, 0.02], I: 0.05,
     motor: {ratio: -30, inertia: 3e-5, damping: 1e-5}}
  - {name: d, joint: prismatic, axis: [0, 1], from: [0, 0], m: 0.7, l: 0.2, r: 0.25, I: 0.02,
     motor: {ratio: 100, inertia: 2e-5}}
"""
STOPS = """
gravity: [1.3, -9.6]
links:
  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082, limits: {min: -30deg, max: 60deg, stiffness: 50}}
  - {name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031, limits: {max: 0.4, stiffness: 30}, damping: 0.1}
  - {name: c, joint: prismatic, axis: [1, 0], m: 0.9, l: 0.6, r: 0.25, I: 0.031,
     limits: {min: -0.1, stiffness: 100}}
springs:
  - {joint: c, law: "100*x + 3*x**2 - x**3/2 + 2*v", length: 0.1}
  - {joint: a, law: "x*(1 + x)", angle: 0.3}
  - {between: [c, [1, 1]], law: "40*x + 0.3*v**3", length: 0.1}
"""
CART = """
gravity: 9.8
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 1.0, l: 0, r: 0, I: 0}
  - {name: pole, m: 0.1, l: 1.0, r: 0.5, I: 0.008333333333333333}
"""
GEARS = {
    "rig, geared": """
couplings: ["q3 = -2 q1 + 0.1", "q2 = q4 - 1/3 q1"]
actuated: [plate, slide]
""",
    "rig, locked": """
couplings: q3 = 30deg
actuated: [plate, left, slide]
""",
    "rig, one gear": """
couplings: q2 = -2 q1 + 0.1  # Pinocchio forgets turns, which a fraction would not
actuated: [plate, far hand, slide]
""",
}
SOFT, SOFT_GEARS = 1e-5, 2e-4  # relative, of the accelerations that MuJoCo's constraints allow
PIN_MOTION, SLIDER_MOTION = (2e-5, 1e-6), (6e-3, 4e-4)  # rad and m, see ran in mujoco_peer
SOLVED = 1e-12  # relative, what the solver of its constraints leaves
# the same where joints slide: a rod moves less mass than a crank, a yoke has dead centres
SOFT_SLIDES, SOLVED_SLIDES = 1e-4, 1e-11


def exports(engines: dict[str, ModuleType]) -> Iterator[Row]:
    """The written models, loaded."""
    mechanisms = {name: robodyn.load(ROOT / f"robots/{name}.yaml") for name in EXPORTED}
    mechanisms["rig"] = build(from_text(RIG, "rig"))
    mechanisms["rig with springs and loads"] = build(from_text(RIG + FORCES, "rig"))
    slides = {"slides": SLIDES, "slides with springs and loads": SLIDES + SLIDE_FORCES}
    slides |= {"cart and pole": CART, "motors": MOTORS, "stops and laws of springs": STOPS}
    mechanisms |= {name: build(from_text(text, name)) for name, text in slides.items()}
    mechanisms |= {name: build(from_text(RIG + text, name)) for name, text in GEARS.items()}
    for scene, mechanism in mechanisms.items():
        q, qd, qdd = motion_states(mechanism, STATES)
        known = compared(mechanism, q, qd, qdd)
        for name, engine in engines.items():
            if not hasattr(engine, "exported"):
                continue
            try:
                model = engine.exported(mechanism)
            except InputError:  # what URDF cannot say
                continue
            terms = model.terms()
            value = max(apart(known[term], function) for term, function in terms.items())
            what = f"{scene}, {' '.join(terms)}"
            yield Row("export", what, f"{name}, exported", value, "", bound=ROUNDING)
            if mechanism.rows and name == "mujoco":
                yield from closed_exports(scene, mechanism, model, known)


def closed_exports(
    scene: str, mechanism: Mechanism, model: Any, known: dict[str, Compared]
) -> Iterator[Row]:
    """Constraints of a model against the closures, their forces, and what softness does.

    The forces f of the constraints obey, with the matrix R of MuJoCo's softness and the gains
    k and b with which it closes gaps,

        M qdd + C qd + D qd + G - Q = Psi^T f    Psi qdd + Psidot qd + R f = -k gap - b Psi qd

    where Psidot qd is left out for tendons.  Near change points any softness shows.
    """
    q, qd = known["bias"].arguments
    found = [model.constraints(*state) for state in zip(q, qd, strict=True)]
    J, gap, force, R, closing, qdd = (np.array(part) for part in zip(*found, strict=True))
    slider = [row.closure in sliders(mechanism) for row in mechanism.rows]
    Psi, bias = robodyn.closure_jacobian(mechanism, q), closure_bias(mechanism, q, qd, t=0.0)
    bias[..., slider] = 0.0
    M, C = robodyn.mass_matrix(mechanism, q), robodyn.coriolis_matrix(mechanism, q, qd)
    damping = np.diag(mechanism.arrays.damping)
    motion = [product(M, qdd), product(C + damping, qd), robodyn.gravity_vector(mechanism, q)]
    motion.append(-robodyn.other_forces(mechanism, q, qd))
    forces = -product(np.swapaxes(Psi, -1, -2), force)
    size = np.full(len(q), loop_size(mechanism))
    hard = known["qdd"].ours
    soft = SOFT_GEARS if mechanism.description.couplings else SOFT
    soft, solved = (SOFT_SLIDES, SOLVED_SLIDES) if mechanism.slides else (soft, SOLVED)
    rows = {
        "Psi and gap": (max(worst(J - Psi, Psi), worst(gap, size)), ROUNDING),
        "qdd and forces": (worst(sum(motion) + forces, *motion, forces), solved),
        "softness": (
            worst(
                product(Psi, qdd) + bias + R * force - closing,
                product(np.abs(Psi), np.abs(qdd)),
                bias,
            ),
            SOLVED,
        ),
        "qdd of hard closures": (
            worst(qdd - hard, known["qdd"].terms),
            None if any(slider) or scene == "parallelogram" else soft,
        ),
    }
    for term, (value, bound) in rows.items():
        yield Row("export", f"{scene}, {term}", "mujoco, exported", value, "", bound=bound)
    for timestep, part in ((1e-3, 1.0), (1e-4, 0.02)):
        what = f"{scene}, 1 s in steps of {timestep:g} s"
        limits = SLIDER_MOTION if any(slider) else PIN_MOTION
        for value, unit, limit in zip(model.ran(timestep), ("rad", "m"), limits, strict=True):
            name = f"{what}, {'q' if unit == 'rad' else 'gap'}"
            yield Row("export", name, "mujoco, exported", value, unit, bound=limit * part)


def sliders(mechanism: Mechanism) -> set[int]:
    closures = enumerate(mechanism.description.closures)
    return {c for c, closure in closures if closure.along is not None}
