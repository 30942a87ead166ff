"""`robodyn export`: the mechanism as a model file of other tools."""

from __future__ import annotations

from dataclasses import MISSING
from typing import Literal

from robodyn.cli.options import Model, Number, Out, Q, Text, option, refuse
from robodyn.cli.output import note
from robodyn.cli.states import Quantity, single_state
from robodyn.errors import InputError
from robodyn.export.mjcf import TIMESTEP, check_mjcf, mjcf
from robodyn.export.model_xml import contact_notes, vector
from robodyn.export.scene_text import check_tables, scene_text
from robodyn.export.urdf import urdf, urdf_notes
from robodyn.loops.assembly import first_pose
from robodyn.tables.output_file import write_text

TIMELESS = "this scene is the same at all times; a model file has no laws or loads of the time"
ModelFormat = Literal["urdf", "mjcf", "scene"]  # the language of a model file


def export(
    model: Model,
    format: ModelFormat = option("urdf (ROS, Pinocchio), mjcf (MuJoCo) or scene.", default=MISSING),
    q: Q = None,
    timestep: Number = option("Of mjcf, s. Default: 0.001.", "S"),
    at_time: Text = option("", hidden=True),
    out: Out = None,
) -> None:
    """The same mechanism as URDF or MJCF, for other tools, or as a scene by its numbers.

    Each joint of the model is named after its link and has the coordinate q_i; the plane is X-Y.
    URDF holds open chains only, and no gravity: set it where the file is loaded.  MJCF closes
    loops by equality constraints; it begins at --q, else at zero, or where loops close first, and
    has that configuration as the keyframe `start`.  A scene is written in the explicit form: links
    by lengths, closures, and of a mechanism as drawn the pose that it starts in.

    \b
    Examples:
      robodyn export 2r --format urdf --out 2r.urdf
      robodyn export four-bar --format mjcf --q 60deg > four-bar.xml
      robodyn export jansen-leg --format scene -o lengths.yaml
    """
    mechanism = model.load()
    if format == "scene":
        refuse("is for models of other tools", q=q, timestep=timestep)
        refuse("a scene is written for all times", at_time=at_time)
        check_tables(mechanism, out)
        if "#" in mechanism.description.written.text:
            note("Note: the comments of the file are left out")
        write_text(scene_text(mechanism), out)
        return
    if format == "urdf":
        refuse("is for mjcf, urdf has no word for it", q=q, timestep=timestep)
        text, notes = urdf(mechanism), urdf_notes(mechanism)
        refuse(TIMELESS, at_time=at_time)
        if mechanism.gamma:
            gravity = f"({', '.join(vector(mechanism.gamma).split())})"
            note(f"Note: URDF has no gravity: set {gravity} m/s^2 where it is loaded")
    else:
        step = TIMESTEP if timestep is None else timestep
        if not 0.0 < step < float("inf"):
            raise InputError("--timestep", value=step, limit="must be > 0 and finite, s")
        check_mjcf(mechanism)
        refuse(TIMELESS, at_time=at_time)
        pose = None
        if q is not None:
            pose = single_state(mechanism, [Quantity("q", q, True)], t=0.0)[0].tolist()
        elif mechanism.rows:
            pose = first_pose(mechanism, t=0.0).tolist()
            note(f"Note: without --q it begins at q = {', '.join(f'{x:.6g}' for x in pose)}")
        text, notes = mjcf(mechanism, step, pose), contact_notes(mechanism)
    for line in notes:
        note(f"Note: {line}")
    if mechanism.description.points:
        note(f"Note: {format.upper()} has no named points: the scene's `points` are left out")
    write_text(text, out)
