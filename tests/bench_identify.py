"""What identification of a long measured motion costs beside numpy's reading of its file."""

from __future__ import annotations

import os
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import robodyn
from robodyn.cli.motion_files import read_motion
from robodyn.mechanics.mechanism import load
from robodyn.parameters.base_parameters import random_states

ROWS = 100_000
DRAWN = 2_000  # states, which repeat
BOUND = 3.0  # times numpy's loadtxt


def identification(bench: Any) -> list[Any]:
    """Reading the file and finding the base parameters, of an arm and of a loop."""
    from bench import ROOT, compared, in_turn

    rows = []
    for name in ("2r", "four-bar"):
        mechanism = load(ROOT / f"robots/{name}.yaml")
        states = [np.tile(x, (ROWS // DRAWN, 1)) for x in random_states(mechanism, DRAWN)]
        tau = robodyn.inverse_dynamics(mechanism, *states)[:, list(mechanism.actuated)]
        tau = tau + 0.01 * np.random.default_rng(0).normal(size=tau.shape)
        table = np.column_stack([1e-3 * np.arange(ROWS), *states, tau])
        joints = range(1, mechanism.n + 1)
        header = ["t", *(f"{x}{k}" for x in ("q", "qd", "qdd") for k in joints)]
        header += [f"tau{k + 1}" for k in mechanism.actuated]
        with TemporaryDirectory() as folder:
            file = os.path.join(folder, "data.csv")
            with open(file, "w", encoding="utf-8") as stream:
                stream.write(",".join(header) + "\n")
                stream.writelines(",".join(map(repr, row)) + "\n" for row in table.tolist())

            def found(mechanism: Any = mechanism, file: str = file) -> object:
                motion = read_motion(mechanism, file, torques=True)
                return robodyn.identify(mechanism, *motion.states, motion.tau, motion.t)

            def read(file: str = file) -> object:
                return np.loadtxt(file, delimiter=",", skiprows=1)

            times = in_turn(found, read, bench.repeats)
        what = f"identify, {ROWS:,} rows, {name}"
        rows.append(compared(what, times, ROWS, "loadtxt", bound=BOUND))
    return rows
