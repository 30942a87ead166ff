"""Pinocchio: the scene built joint by joint, revolute about the normal of the plane.

Closures are its rigid constraints between two joints.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
from bench_frontier import Array, Run

from robodyn import Mechanism
from robodyn.export.model_xml import Names, link_names
from robodyn.export.urdf import urdf
from robodyn.scene.scene import Description


class Model:
    """A scene in Pinocchio, joints in robodyn's order at the surface."""

    def __init__(self, description: Description) -> None:
        links = description.links
        if any(link.payload or link.damping for link in links):
            raise NotImplementedError("payload, damping")
        self.model = pin.Model()
        gravity = description.gravity
        self.model.gravity.linear = np.array([gravity.real, gravity.imag, 0.0])
        self.ids: dict[int | None, int] = {None: 0}
        self._hang(description, None)
        ids = [self.ids[k] for k in range(len(links))]
        frames = tip_frames(self.model, ids, [link.l for link in links])
        self.data = self.model.createData()
        joints = [self.model.joints[self.ids[k]].idx_v for k in range(len(links))]
        self.joints = np.array(joints)
        self.back = np.argsort(self.joints)  # theirs[back] of ours
        self.tips = Tips(self.model, frames, self.joints, self._turned, self._turned)
        self.closures = pin.StdVec_RigidConstraintModel()
        for closure in description.closures:
            if closure.along is not None:
                raise NotImplementedError("slider")
            sides = [
                side
                for point in (closure.first, closure.second)
                for side in (self.ids[point.link], _placed(point.at))
            ]
            kind = pin.ContactType.CONTACT_3D
            self.closures.append(pin.RigidConstraintModel(kind, self.model, *sides))
        self.closed = pin.StdVec_RigidConstraintData()
        for constraint in self.closures:
            self.closed.append(constraint.createData())

    def _hang(self, description: Description, above: int | None) -> None:
        """Add what hangs from a link, depth first as its algorithms want it."""
        for k, link in enumerate(description.links):
            if link.hangs_from.link == above:
                place = _placed(link.hangs_from.at)
                joint = self.model.addJoint(self.ids[above], pin.JointModelRZ(), place, link.name)
                centre = np.array([link.r.real, link.r.imag, 0.0])
                inertia = pin.Inertia(link.m, centre, link.I * np.eye(3))
                self.model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
                self.ids[k] = joint
                self._hang(description, k)

    def _turned(self, values: Array) -> Array:
        return values[self.back]

    def M(self, q: Array) -> Array:
        full = np.triu(pin.crba(self.model, self.data, q[self.back]))
        full = full + np.triu(full, 1).T
        return full[np.ix_(self.joints, self.joints)]

    def G(self, q: Array) -> Array:
        return pin.computeGeneralizedGravity(self.model, self.data, q[self.back])[self.joints]

    def bias(self, q: Array, qd: Array) -> Array:
        found = pin.nonLinearEffects(self.model, self.data, q[self.back], qd[self.back])
        return found[self.joints]

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        back = self.back
        return pin.rnea(self.model, self.data, q[back], qd[back], qdd[back])[self.joints]

    def slopes(self, q: Array, qd: Array, qdd: Array) -> Array:
        """d tau by q, qd and qdd, side by side, (n, 3n)."""
        back = self.back
        found = pin.computeRNEADerivatives(self.model, self.data, q[back], qd[back], qdd[back])
        by_q, by_qd, M = found
        M = np.triu(M) + np.triu(M, 1).T
        return np.hstack([x[np.ix_(self.joints, self.joints)] for x in (by_q, by_qd, M)])

    def forward_slopes(self, q: Array, qd: Array) -> Array:
        """d qdd by q, qd and tau, without torques."""
        back = self.back
        state = q[back], qd[back], np.zeros(len(q))
        by_q, by_qd, Minv = pin.computeABADerivatives(self.model, self.data, *state)
        Minv = np.triu(Minv) + np.triu(Minv, 1).T
        return np.hstack([x[np.ix_(self.joints, self.joints)] for x in (by_q, by_qd, Minv)])

    def tangents(self) -> dict[str, Callable[..., Array]]:
        """What is exact of derivatives: of an open tree."""
        return {
            "dtau": self.slopes,
            "dqdd": self.forward_slopes,
            "regressor": self.regressor,
        }

    def regressor(self, q: Array, qd: Array, qdd: Array) -> Array:
        """The columns of m, m rx, m ry and Izz of each link, (n, 4n); the others are spatial."""
        back = self.back
        state = q[back], qd[back], qdd[back]
        found = np.atleast_2d(pin.computeJointTorqueRegressor(self.model, self.data, *state))
        places = [10 * (self.ids[k] - 1) + i for k in range(len(q)) for i in (0, 1, 2, 9)]
        return found[np.ix_(self.joints, places)]

    def accelerations(self, q: Array, qd: Array) -> Array:
        """Without torques; closures by its proximal solver, whose normal row is empty."""
        state = q[self.back], qd[self.back], np.zeros(len(q))
        if not self.closures:
            return pin.aba(self.model, self.data, *state)[self.joints]
        pin.initConstraintDynamics(self.model, self.data, self.closures, self.closed)
        settings = pin.ProximalSettings(1e-15, 1e-9, 30)
        constraints = self.closures, self.closed, settings
        found = pin.constraintDynamics(self.model, self.data, *state, *constraints)
        return found[self.joints]

    def closed_torques(self, actuated: tuple[int, ...]) -> Callable[..., Array]:
        """rnea's torques shared out among the actuated joints and the closures' Jacobian."""

        def torques(q: Array, qd: Array, qdd: Array) -> Array:
            free = self.torques(q, qd, qdd)
            pin.computeJointJacobians(self.model, self.data, q[self.back])
            shares = [np.eye(len(q))[:, list(actuated)]]
            for constraint, data in zip(self.closures, self.closed, strict=True):
                constraint.calc(self.model, self.data, data)
                full = pin.getConstraintJacobian(self.model, self.data, constraint, data)
                shares.append(full[:2, self.joints].T)
            tau = np.zeros(len(q))
            solution = np.linalg.solve(np.hstack(shares), free)
            tau[list(actuated)] = solution[: len(actuated)]
            return tau

        return torques


def tip_frames(model: pin.Model, joints: Sequence[int], lengths: Sequence[float]) -> list[int]:
    """A frame at the tip of each link, by the joint that moves it; to be added before the data."""
    kind = pin.FrameType.OP_FRAME
    return [
        model.addFrame(pin.Frame(f"tip {k}", joint, _placed(complex(length)), kind))
        for k, (joint, length) in enumerate(zip(joints, lengths, strict=True))
    ]


class Tips:
    """How tips move, by forward kinematics: its places, velocities, classical accelerations.

    `configuration` and `rates` make its own of ours, `joints` are the places of its rates.
    """

    def __init__(
        self,
        model: pin.Model,
        frames: Sequence[int],
        joints: Array,
        configuration: Callable[[Array], Array],
        rates: Callable[[Array], Array],
    ) -> None:
        self.model, self.frames, self.joints = model, frames, joints
        self.data = model.createData()
        self.configuration, self.rates = configuration, rates

    def places(self, q: Array) -> Array:
        pin.framesForwardKinematics(self.model, self.data, self.configuration(q))
        return np.array([self.data.oMf[frame].translation[:2] for frame in self.frames])

    def velocities(self, q: Array, qd: Array) -> Array:
        pin.forwardKinematics(self.model, self.data, self.configuration(q), self.rates(qd))
        return np.array([self._of(pin.getFrameVelocity, frame) for frame in self.frames])

    def accelerations(self, q: Array, qd: Array, qdd: Array) -> Array:
        state = self.configuration(q), self.rates(qd), self.rates(qdd)
        pin.forwardKinematics(self.model, self.data, *state)
        call = pin.getFrameClassicalAcceleration
        return np.array([self._of(call, frame) for frame in self.frames])

    def _of(self, call: Callable[..., pin.Motion], frame: int) -> Array:
        kind = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return call(self.model, self.data, frame, kind).linear[:2]

    def jacobian(self, q: Array) -> Array:
        pin.computeJointJacobians(self.model, self.data, self.configuration(q))
        pin.updateFramePlacements(self.model, self.data)
        kind = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        found = [pin.getFrameJacobian(self.model, self.data, x, kind) for x in self.frames]
        # of one joint it is no matrix
        return np.array(found).reshape(len(found), 6, -1)[:, :2, self.joints]

    def terms(self) -> dict[str, Callable[..., Array]]:
        if not self.frames:
            return {}
        return {
            "point": self.places,
            "point velocity": self.velocities,
            "point acceleration": self.accelerations,
            "point Jacobian": self.jacobian,
        }


class Exported:
    """The URDF that `robodyn export` writes, joints found by their names.

    Its angles are stored as cosine and sine, displacements as they are; gravity is set, and damping
    is added, which its algorithms leave out.  Joints that mimic others have no coordinates.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        text, names = urdf(mechanism), link_names(mechanism, Names())
        following = {coupling.joint for coupling in mechanism.description.couplings}
        self.model = pin.buildModelFromXML(text, mimic=bool(following))
        gravity = mechanism.gamma
        self.model.gravity.linear = np.array([gravity.real, gravity.imag, 0.0])
        lengths = [link.l for link in mechanism.description.links]
        ids = [self.model.getJointId(name) for name in names]
        frames = [] if following else tip_frames(self.model, ids, lengths)
        self.data = self.model.createData()
        self.free = [k for k in range(mechanism.n) if k not in following]
        joints = [self.model.joints[self.model.getJointId(names[k])] for k in self.free]
        self.places = np.array([joint.idx_q for joint in joints])
        self.turning = np.array([joint.nq == 2 for joint in joints])
        self.joints = np.array([joint.idx_v for joint in joints])
        self.back = np.argsort(self.joints)
        self.damping = np.array(self.model.damping)[self.joints]
        self.tips = Tips(self.model, frames, self.joints, self.configuration, self.rates)

    def configuration(self, q: Array) -> Array:
        found, free = np.empty(self.model.nq), q[self.free]
        found[self.places] = np.where(self.turning, np.cos(free), free)
        found[self.places[self.turning] + 1] = np.sin(free[self.turning])
        return found

    def rates(self, qd: Array) -> Array:
        return qd[self.free][self.back]

    def M(self, q: Array) -> Array:
        full = np.triu(pin.crba(self.model, self.data, self.configuration(q)))
        full = full + np.triu(full, 1).T
        return full[np.ix_(self.joints, self.joints)]

    def bias(self, q: Array, qd: Array) -> Array:
        state = self.configuration(q), self.rates(qd)
        return pin.nonLinearEffects(self.model, self.data, *state)[self.joints]

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        state = self.configuration(q), self.rates(qd), self.rates(qdd)
        return pin.rnea(self.model, self.data, *state)[self.joints] + self.damping * qd

    def accelerations(self, q: Array, qd: Array) -> Array:
        return self.driven(q, qd, np.zeros_like(q))

    def driven(self, q: Array, qd: Array, tau: Array) -> Array:
        state = self.configuration(q), self.rates(qd), self.rates(tau - self.damping * qd)
        return pin.aba(self.model, self.data, *state)[self.joints]

    def terms(self) -> dict[str, Callable[..., Array]]:
        if self.model.njoints > self.model.nv + 1:
            return {"M reduced": self.M, "bias reduced": self.bias}
        return {
            "M": self.M,
            "G": lambda q: self.bias(q, np.zeros_like(q)),
            "bias": self.bias,
            "tau": self.torques,
            "qdd": self.accelerations,
            "driven": self.driven,
            **self.tips.terms(),
        }


def exported(mechanism: Mechanism) -> Exported:
    return Exported(mechanism)


def _placed(point: complex) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([point.real, point.imag, 0.0]))


def terms(mechanism: Mechanism) -> dict[str, Callable[..., Array]]:
    model = Model(mechanism.description)
    closed = model.closed_torques(mechanism.actuated)
    return {
        "M": model.M,
        "G": model.G,
        "bias": model.bias,
        "tau": closed if mechanism.rows else model.torques,
        "qdd": model.accelerations,
        **({} if mechanism.rows else model.tangents()),
        **model.tips.terms(),
    }


def batches(tree: Mechanism, q: Array, qd: Array, qdd: Array) -> dict[str, Run]:
    """Inverse dynamics of all rows: a loop in Python, and its own over a pool of threads."""
    made = Model(tree.description)
    model, data = made.model, made.data
    rows = [np.ascontiguousarray(x[:, made.back]) for x in (q, qd, qdd)]
    columns = [x.T for x in rows]  # a state a column, contiguous

    def loop() -> Array:
        tau = np.empty_like(rows[0])
        for k, (position, rate, acceleration) in enumerate(zip(*rows, strict=True)):
            tau[k] = pin.rnea(model, data, position, rate, acceleration)
        return tau[:, made.joints]

    def parallel(threads: int) -> Run:
        pool = pin.ModelPool(model, threads)
        tau = np.empty_like(columns[0])

        def run() -> Array:
            pin.rneaInParallel(threads, pool, *columns, tau)
            return tau.T[:, made.joints]

        return run

    found = {"rnea, a loop": loop}
    if hasattr(pin, "rneaInParallel"):
        for threads in sorted({1, os.cpu_count() or 1}):
            found[f"rneaInParallel, {threads} thread" + "s" * (threads > 1)] = parallel(threads)
    return found
