"""MuJoCo: the scene as MJCF text, hinges about the normal of the plane, closures as connects.

Its constraints are soft, so that a closed mechanism's accelerations and torques are not meant to
be the exact ones: M, G and the bias are compared, which are those of the opened tree, and what
softness does to the accelerations is shown.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
from bench_frontier import Array, Case, Run

import robodyn
from peers.agreement import SLIDE
from robodyn import Mechanism
from robodyn.export.mjcf import mjcf as exported_text
from robodyn.export.model_xml import Names, link_names
from robodyn.scene.scene import Description

STEPS = [round(250 * 2 ** (k / 2)) for k in range(20)]  # fewer are unstable


def mjcf(description: Description, timestep: float = 0.002) -> str:
    """The scene; body and joint k are link k."""
    links = description.links
    if any(link.payload or link.damping for link in links):
        raise NotImplementedError("payload, damping")
    sites: dict[int | None, str] = {}
    connects = ""
    for c, closure in enumerate(description.closures):
        if closure.along is not None:
            raise NotImplementedError("slider")
        for side, point in (("a", closure.first), ("b", closure.second)):
            site = f'<site name="{side}{c}" pos="{_vector(point.at)}"/>'
            sites[point.link] = sites.get(point.link, "") + site
        connects += f'<connect site1="a{c}" site2="b{c}"/>'

    def bodies(above: int | None) -> str:
        text = sites.get(above, "")
        for k, link in enumerate(links):
            if link.hangs_from.link == above:
                inertia = " ".join([repr(link.I)] * 3)  # the third counts, the others must fit it
                text += (
                    f'<body name="{k}" pos="{_vector(link.hangs_from.at)}">'
                    f'<joint name="{k}" type="hinge" axis="0 0 1"/>'
                    f'<inertial mass="{link.m!r}" pos="{_vector(link.r)}" diaginertia="{inertia}"/>'
                    f"{bodies(k)}</body>"
                )
        return text

    return (
        '<mujoco><compiler angle="radian"/>'
        f'<option gravity="{_vector(description.gravity)}" timestep="{timestep!r}"'
        ' integrator="RK4"/>'
        f"<worldbody>{bodies(None)}</worldbody><equality>{connects}</equality></mujoco>"
    )


def _vector(point: complex) -> str:
    return f"{point.real!r} {point.imag!r} 0"


class Model:
    """A compiled scene and its data, joints in robodyn's order."""

    def __init__(self, description: Description, timestep: float = 0.002) -> None:
        self.model = mujoco.MjModel.from_xml_string(mjcf(description, timestep))
        self.data = mujoco.MjData(self.model)
        names = [str(k) for k in range(len(description.links))]
        self.joints = np.array([self.model.joint(name).dofadr[0] for name in names])

    def put(self, q: Array, qd: Array) -> None:
        self.data.qpos[self.joints] = q
        self.data.qvel[self.joints] = qd

    def M(self, q: Array) -> Array:
        self.bias(q, np.zeros_like(q))
        full = np.zeros((len(q), len(q)))
        mujoco.mj_fullM(self.model, self.data, full)
        return full[np.ix_(self.joints, self.joints)]

    def bias(self, q: Array, qd: Array) -> Array:
        self.put(q, qd)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qfrc_bias[self.joints]

    def accelerations(self, q: Array, qd: Array) -> Array:
        mujoco.mj_resetData(self.model, self.data)  # no warm start
        self.put(q, qd)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qacc[self.joints]

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        self.put(q, qd)
        self.data.qacc[self.joints] = qdd
        mujoco.mj_inverse(self.model, self.data)
        return self.data.qfrc_inverse[self.joints]


class Exported(Model):
    """The model that `robodyn export` writes, joints found by their names."""

    def __init__(self, mechanism: Mechanism, timestep: float = 0.001) -> None:
        self.mechanism = mechanism
        text = exported_text(mechanism, timestep)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self.model.opt.tolerance = 0.0  # of its solver: as far as it gets
        self.data = mujoco.MjData(self.model)
        self.names = link_names(mechanism, Names())
        self.joints = np.array([self.model.joint(name).dofadr[0] for name in self.names])

    def terms(self) -> dict[str, Callable[..., Array]]:
        found: dict[str, Callable[..., Array]] = {"M": self.M}
        description = self.mechanism.description
        if not (description.springs or description.loads):  # which are not in its bias
            found |= {"G": lambda q: self.bias(q, np.zeros_like(q)), "bias": self.bias}
        if not self.mechanism.rows:
            found |= {"tau": self.torques, "qdd": self.accelerations, "driven": self.driven}
        return found

    def driven(self, q: Array, qd: Array, tau: Array) -> Array:
        """Accelerations by the controls of its motors."""
        for k in self.mechanism.actuated:
            self.data.actuator(self.names[k]).ctrl = tau[k]
        self.put(q, qd)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qacc[self.joints].copy()

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Its inverse dynamics leaves out actuators, as which loads are written."""
        self.put(q, qd)
        mujoco.mj_forward(self.model, self.data)
        loads = self.data.qfrc_actuator[self.joints].copy()
        return super().torques(q, qd, qdd) - loads

    def constraints(self, q: Array, qd: Array) -> tuple[Array, ...]:
        """J, residual, force, R and what closes gaps, of the rows of closures; and qdd.

        A connect has a third row, normal to the plane, which is empty.  A slider's row counts
        lengths, a coupling's and a kept angle's row angles: a unit of its gap is `scale` of them.
        """
        qdd = self.accelerations(q, qd)
        data, rows, scales = self.data, [], []
        for k, kind in enumerate(self.model.eq_type):
            found = np.flatnonzero(data.efc_id == k)[:2].tolist()
            scale, name = 1.0, self.model.equality(k).name
            if name.startswith("coupling") or name.endswith("_angle"):
                scale = 1.0 / self.mechanism.rows[len(rows)].arm
            elif kind == mujoco.mjtEq.mjEQ_TENDON:
                ends = (f"{name}_{end}" for end in ("point", "left", "right"))
                point, left, right = (data.site(end).xpos for end in ends)
                scale = np.linalg.norm(left - right) / np.linalg.norm(point - right)
            rows += found
            scales += [scale] * len(found)
        J = data.efc_J.reshape(data.nefc, -1)[:, self.joints]
        assert not np.delete(J, rows, axis=0).any()
        scale = np.array(scales)
        k, b, impedance, _ = data.efc_KBIP.reshape(-1, 4).T
        closing = -k * impedance * data.efc_pos - b * data.efc_vel
        return (
            J[rows] / scale[:, None],
            data.efc_pos[rows] / scale,
            data.efc_force[rows] * scale,
            data.efc_R[rows] / scale**2,
            closing[rows] / scale,
            qdd,
        )

    def ran(self, timestep: float) -> tuple[float, float]:
        """A second from the angles 1 at rates 5 (of actuated joints): error of q, largest gap."""
        mechanism = self.mechanism
        unit = np.array([SLIDE if k in mechanism.slides else 1.0 for k in mechanism.actuated])
        q = robodyn.assemble(mechanism, unit)
        qd = robodyn.loop_velocities(mechanism, q, 5.0 * unit)
        exact = robodyn.simulate(mechanism, q, qd, 1.0, rtol=1e-12, atol=1e-12).q[-1]
        model = Exported(mechanism, timestep)
        model.put(q, qd)
        gap = 0.0
        for _ in range(round(1.0 / timestep)):
            mujoco.mj_step(model.model, model.data)
            now = model.data.qpos[model.joints]
            gap = max(gap, float(np.abs(robodyn.closure_gap(mechanism, now)).max()))
        return float(np.abs(model.data.qpos[model.joints] - exact).max()), gap


def exported(mechanism: Mechanism) -> Exported:
    return Exported(mechanism)


def terms(mechanism: Mechanism) -> dict[str, Callable[..., Array]]:
    model = Model(mechanism.description)
    found = {"M": model.M, "G": lambda q: model.bias(q, np.zeros_like(q)), "bias": model.bias}
    if mechanism.rows:
        return found | {"qdd, soft closures": model.accelerations}
    return found | {"tau": model.torques, "qdd": model.accelerations}


def batches(tree: Mechanism, q: Array, qd: Array, qdd: Array) -> dict[str, Run]:
    model = Model(tree.description)

    def loop() -> Array:
        return np.array(list(map(model.torques, q, qd, qdd)))

    return {"mj_inverse, a loop": loop}


def runs(case: Case, tolerances: list[float]) -> dict[str, list[Run]]:
    """RK4 at fixed steps, which stand for tolerances, the loop over them inside MuJoCo."""
    if case.mechanism.rows:
        raise NotImplementedError("soft closures: another motion")
    n = case.mechanism.n

    def run(model: Model, steps: int) -> Array:
        mujoco.mj_resetData(model.model, model.data)
        model.put(case.start[:n], case.start[n:])
        mujoco.mj_step(model.model, model.data, steps)
        return np.concatenate([model.data.qpos[model.joints], model.data.qvel[model.joints]])

    description = case.mechanism.description
    models = [(Model(description, case.time / steps), steps) for steps in STEPS]
    return {"RK4, fixed steps": [partial(run, model, steps) for model, steps in models]}
