"""sweep for notebooks: the table that the command writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any, get_args

import numpy as np

from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.notebook.inline import named_as_arguments
from robodyn.scene.scene_values import SceneValues
from robodyn.scene.yaml_tree import Scalar
from robodyn.scene.yaml_tree import Sequence as ListOf
from robodyn.sweeps.sweep_plan import check
from robodyn.sweeps.sweep_request import Kind, SweepRequest, plan_of
from robodyn.sweeps.sweep_workers import results, without_remarks
from robodyn.tables.named_columns import Columns

VECTORS = ("q", "qd", "qdd", "tau")


def sweep(
    mechanism: Mechanism,
    vary: Mapping[str, str | Sequence[float]],
    *,
    sample: int | None = None,
    workers: int | None = 1,
    **options: Any,
) -> Columns:
    """The same simulation, or torque, at many points: columns by name, as the command writes them.

    `vary` has for each joint's start, torque, or number of the scene its values: a list, or what
    --vary takes, "0:360deg:37" or, with `sample`, "0.5:1.5", "normal(1.3, 0.02)".  `options` are
    those of the command: kind, q, qd, qdd, tau, time, result, of, points, event, flip, seed, rtol,
    atol, max_steps.  `workers` are threads or processes; None: one a processor.  A point
    without a result has nan.  Raises InputError for what does not fit.
    """
    known = SweepRequest.__dataclass_fields__
    if not isinstance(vary, Mapping) or not vary:
        raise InputError("vary", limit='must be a mapping, such as {"q1": [0, 0.1, 0.2]}')
    for name in options:
        if name not in known:
            raise InputError(name, limit=f"is no option of sweep; there are {', '.join(known)}")
    if (kind := options.get("kind", "motion")) not in get_args(Kind):
        limit = f"must be one of {', '.join(get_args(Kind))}"
        raise InputError("kind", value=kind, limit=limit)
    axes = [f"{name}={_values(values)}" for name, values in vary.items()]
    given = {name: _values(x) if name in VECTORS else x for name, x in options.items()}
    for name in ("of", "event"):
        if isinstance(given.get(name), str):
            given[name] = [given[name]]
    if isinstance(given.get("result"), Sequence) and not isinstance(given["result"], str):
        given["result"] = ",".join(map(str, given["result"]))
    written = mechanism.description.written
    scene, numbers = SceneValues(written, mechanism.source), {}
    for put in written.put:  # what stands in place of the file's numbers
        numbers.update({scene.own_name(name): _written(x) for name, x in put.items()})
    with named_as_arguments():
        request = SweepRequest(vary=axes, sample=sample, **given)
        plan = plan_of(scene, tuple(numbers.items()), request)
        check(plan)
    with without_remarks(), closing(results(plan, 0, workers)) as chunks:
        rows = list(chunks)
    names = plan.columns()
    values = np.concatenate([chunk.values for chunk in rows])
    outcomes = [word for chunk in rows for word in chunk.outcomes]
    return Columns(zip(names, [*values.T, outcomes], strict=True))


def _written(value: object) -> str:
    """A number that was put in a scene, as the scene would have it."""
    if isinstance(value, Scalar):
        return value.text
    if isinstance(value, ListOf):
        return f"[{', '.join(map(_written, value.items))}]"
    return repr(value)


def _values(given: object) -> Any:
    """Numbers as an option has them; text, and nothing, as it is."""
    if given is None or isinstance(given, str):
        return given
    return ",".join(repr(float(x)) for x in np.atleast_1d(np.asarray(given, float)))
