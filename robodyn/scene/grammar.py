"""The grammar of scene files, written once: every key with its kind, unit, default and help.

From it come the reader's checks (`description.py`), the JSON Schema (`scene_schema.py`), the names
of numbers that sweeps vary (`scene_values.py`) and the symbols of equations (`parameters.py`); the
tables of the guide's page on scenes are held against it.

A kind is that of a value: one of those below, or one that the reader has a method for and the
schema a definition.
"""

from __future__ import annotations

import re
from collections.abc import Container
from typing import NamedTuple

from robodyn.scene.scene import BRANCHES, FRAMES, JOINTS

# what stands for a key of several that exclude one another, one of which a file must have
ONE = ("one of the three", "I or J", "r or centre")


class Key(NamedTuple):
    """A key of a mapping: the kind of its value, what it is, its unit, and what stands for it."""

    kind: str
    help: str
    unit: str = ""
    default: str = "needed"  # as it is told
    listed: bool = False  # whether the value is a list of this kind
    hint: str = ""  # what a message adds where a limit is not kept
    symbol: str = ""  # its letters in equations, and what a legend says of it

    @property
    def needed(self) -> bool:
        """Whether a file must have it."""
        return self.default == "needed"

    @property
    def absent(self) -> bool:
        """Whether there is nothing where a file leaves it out."""
        return self.default in ("none", "the ground", *ONE)


class Form(NamedTuple):
    """A mapping with known keys."""

    help: str
    keys: dict[str, Key]
    one: tuple[tuple[str, ...], ...] = ()  # keys of which a file must have exactly one

    def named(self, needed: bool) -> list[str]:
        """The keys that a file must have, or the others."""
        return [name for name, key in self.keys.items() if key.needed == needed]


NUMBERS = {  # and their limits
    "number": "",
    "angle": "",
    "amount": ">= 0",
    "positive": "> 0",
    "nonzero": "not 0",
    "part": "in [0, 1]",
}
WORDS = {"branch": BRANCHES, "frame": FRAMES, "joint_kind": JOINTS}
BY_JOINT = "rad or m"  # as the joint turns or slides
WITH_UNIT = ("vector", "varying", "varying_vector", "law")  # beside numbers
OR_VECTOR = {"gravity": "number", "centre": "amount"}  # a number of this kind, or [x, y]
# The forms of a mapping of this kind, each with the keys that tell it; the last has none.
MAPPINGS: dict[str, dict[str, tuple[str, ...]]] = {
    "scene": {"drawn_scene": ("pins",), "scene": ()},
    "friction": {"dry_friction": ("static",), "friction": ()},
    "slide_friction": {"slide_dry_friction": ("static",), "slide_friction": ()},
    "limits": {"stops": ("stiffness",), "hard_stops": ("restitution",), "limits": ()},
    "slide_limits": {
        "slide_stops": ("stiffness",),
        "slide_hard_stops": ("restitution",),
        "slide_limits": (),
    },
    "link": {"prismatic_link": ("axis",), "revolute_link": ()},
    "drawn_link": {"drawn_prismatic_link": ("along",), "drawn_revolute_link": ()},
    "ground_pin": {"ground_line": ()},
    "spring": {"slide_spring": ("joint", "length"), "joint_spring": ("joint",), "point_spring": ()},
    "load": {"torque": ("torque",), "point_force": ("point",), "force": ()},
    "closure": {"slider": ()},
    "point": {"link_point": ()},
    "moving_point": {"link_point": ()},
    "varying": {"load_table": ()},
}
# A form begins with its name and what it is.  A row has a key, its kind (with [] a list of these),
# unit, default, help, the symbol of equations and what a message adds; or the form whose keys it
# takes, less some.  A line that begins deeper goes on with the one above.  Of <one, other> the
# first is of joints that turn, the other of those that slide.
_TABLE = """
scene: A planar mechanism: rigid links, pins and sliders. SI units.
  name | name | | the file's name less .yaml | text for titles
  gravity | gravity | m/s² | 0 | a number g acts along -Y; or a vector [gx, gy]
  links | link[] | | needed | list of links, at least one
  closures | closure[] | | none | list of pins and sliders that close loops
  actuated | joints | | all outside of loops, the first of each loop
    | links whose joints carry torque
  assembly | assembly | | open | open or crossed; or a list of these, one for each closure
  start | start | rad or m | none
    | where joints begin when larger loops are assembled, {crank: 30deg}
  couplings | couplings | | none | gears and belts: equations such as q3 = -2 q1 + 0.1
  springs | spring[] | | none | list of springs and dampers, between points or at joints
  loads | load[] | | none | list of forces and torques on links
  points | points | | none
    | names of points of links, {P: {link: coupler, at: [0.5, 0.2]}, Q: rocker}

<revolute, prismatic>_link: A <rigid link; its frame has x from its own joint to its tip,
    link on a prismatic joint: its frame has x along the axis that it slides on>.
  name | name | | needed | any text; no two links share one
  m | amount | kg | needed | mass | m: mass of {}
  l | amount | m | needed | length from the link's own joint to its tip | l: length of {}
  r | centre | m | needed
    | centre of gravity: a point [x, y] of the link, or its distance along it
    | r: centre of gravity of {} | ; write [x, y] for a centre of gravity behind or beside the link
  I | amount | kg m² | I or J | moment of inertia about the centre of gravity
    | I: moment of inertia of {} about its centre of gravity
  J | amount | kg m² | I or J | moment of inertia about the link's own joint
  from | point | | the tip of the link before | the point that it hangs from
  payload | amount | kg | 0 | point mass at the tip | mp: payload at the tip of {}
  joint | joint_kind | | <revolute, needed> | <of its own joint, prismatic>
  <, axis> | direction | | needed
    | which way it slides, [dx, dy] in the frame of what it hangs from
  damping | amount | <N m s/rad, N s/m> | 0 | viscous damping at its own joint
    | d: damping at the joint of {}
  friction | <, slide_>friction | | none | Coulomb friction at its own joint
  limits | <, slide_>limits | | none | where its own joint ends
  motor | <, slide_>motor | | none | motor and gear at its own joint

<, slide_>friction: -<torque, force> tanh(qd/speed)
  <torque, force> | amount | <N m, N> | needed | far above that speed
    | <t, f>f: friction at the joint of {}
  speed | positive | <rad/s, m/s> | needed | what smooths it through rest
    | wf: rate that smooths the friction at the joint of {}
    | : the friction is -<torque, force> tanh(qd/speed)

<, slide_>dry_friction: Friction that sticks: <torque, force> + (static - <torque, force>)
    exp(-(qd/stribeck)^2) against the motion; at rest it holds up to static.
  <torque, force> | amount | <N m, N> | needed | in motion, far above the rate stribeck
    | <t, f>f: friction in motion at the joint of {}
  static | amount | <N m, N> | needed | most that it holds at rest, not below <torque, force>
    | <t, f>s: friction at rest at the joint of {}
  stribeck | positive | <rad/s, m/s> | none | rate over which it falls from static
    | ws: rate over which friction falls at the joint of {}

<, slide_>limits: Limits of a joint, which end a simulation.
  min | <angle, number> | <rad, m> | none | where the joint ends below
    | qmin: where the joint of {} ends below
  max | <angle, number> | <rad, m> | none | where it ends above; one of the two may be missing
    | qmax: where the joint of {} ends above

<, slide_>stops: Compliant stops of a joint.
  like <, slide_>limits
  stiffness | positive | <N m/rad, N/m> | needed | of the stop, which pushes and never pulls
    | ke: stiffness of the stops of {}
  damping | amount | <N m s/rad, N s/m> | 0 | of the stop, while it pushes
    | de: damping of the stops of {}

<, slide_>hard_stops: Hard stops of a joint, which throw it back.
  like <, slide_>limits
  restitution | part | | needed | speed after an impact over that before, from 0 to 1

<, slide_>motor: A motor and its gear at a <revolute, prismatic> joint,
    with a rotor on the link that carries it.
  ratio | nonzero | <, rad/m> | needed
    | the rotor's turn over the joint's, seen from the carrying link
    | N: ratio of the gear at the joint of {}
  inertia | amount | kg m² | needed | of the rotor; it is not in the I of the carrying link
    | J: inertia of the rotor of {}
  damping | amount | N m s/rad | 0 | viscous damping of the rotor | b: damping of the rotor of {}
  torque_max | positive | N m | none | largest torque of the motor
  speed_max | positive | rad/s | none | largest speed of the rotor
  torque_constant | positive | N m/A | none | torque per current; resistance beside it
  resistance | positive | ohm | none | of the winding; torque_constant beside it

link_point: A point of a link.
  link | link_name | | needed | the link's name
  at | vector | m | needed | where, [x, y] in the link's frame

slider: A point of a link that stays on a line: a slider, or a pin in a slot.
  point | moving_point | | needed | a point of a link: its name, or {link, at}
  on | line | | needed | the line
  aligned | angle | rad | none | angle that the point's link keeps to the line's link (or to +X):
    a block that does not turn | beta: angle kept by closure {}

line: A line of the ground or of a link.
  link | link_name | | the ground | the link that has the slot
  through | vector | m | needed | a point of the line
  along | direction | | needed | the line's direction, not [0, 0]

point_spring: A spring and damper between two points.
  between | pair | | needed | its ends, [POINT, POINT], not both of one link or the ground
  stiffness | amount | N/m | one of the three | 0 for a damper alone | k: stiffness of {}
  law | law | N | one of the three | its pull in x, its length less the free one (m), and its rate v
  table | spring_table | N | one of the three
    | a CSV file of its pull: columns x and F, linear between rows
  damping | amount | N s/m | 0 | of a damper beside it | ds: damping of {}
  length | amount | m | needed | free length | S0: free length of {}

<joint, slide>_spring: A spring and damper at a <revolute, prismatic> joint.
  joint | link_name | | needed
    | the link whose own joint it is<; its angle counts from turn to turn, >
  stiffness | amount | <N m/rad, N/m> | one of the three | 0 for a damper alone | k: stiffness of {}
  law | law | <N m, N> | one of the three
    | its pull in x, q less its free <angle (rad), displacement (m)>, and its rate v
  table | spring_table | <N m, N> | one of the three
    | a CSV file of its pull: columns x and F, linear between rows
  damping | amount | <N m s/rad, N s/m> | 0 | of a damper beside it | ds: damping of {}
  <angle, length> | <angle, number> | <rad, m> | needed | free <angle, displacement> of the joint
    | phi: free <angle, displacement> of {}

force: A force at a place of a link.
  link | link_name | | needed | the link that it acts on
  at | vector | m | needed | where, [x, y] in the link's frame
  force | varying_vector | N | needed | [Fx, Fy], each a number, an expression or a table
    | F: force of {}
  frame | frame | | ground | ground: it keeps its direction; link: it turns with the link

point_force: A force at a point.
  point | moving_point | | needed | a point of a link: its name, or {link, at}
  force | varying_vector | N | needed | [Fx, Fy], each a number, an expression or a table
    | F: force of {}
  frame | frame | | ground | ground: it keeps its direction; link: it turns with the link

torque: A torque on a link.
  link | link_name | | needed | the link that it acts on
  torque | varying | N m | needed
    | from the ground, counter-clockwise: a number, an expression or a table | T: torque of {}

load_table: A force or torque by a table, linear between its rows.
  table | name | | needed | the CSV file, from the scene file's folder
  over | name | | needed | t, or a joint q1, ..: its column tells where the rows are
  column | name | | needed | the column of the force or torque

drawn_scene: A planar mechanism as drawn: where its pins are in one pose, and which links have them.
  pins | pins | m | needed | where the pins are in one pose, {A: [0.1, 0.2], B: [0.4, 0.3]}
  links | drawn_link[] | | needed | list of links, at least one
  ground | ground_pin[] | | none | list of the pins that the ground has, or that run on a line of it
  slots | slot[] | | none | list of pins that run on a line of a link
  like scene less links closures assembly start

drawn_<revolute, prismatic>_link: A <rigid link; its frame has x from its first pin to its second,
    link on a prismatic joint: its frame has x along the line that it slides on>.
  pins | pin_names | | needed
    | its pins: the first is its own joint<, ; it may be the only one>
  like <revolute, prismatic>_link less l from joint axis
  r | centre | m | r or centre | centre of gravity: [x, y] of the link, or its distance along it
    | r: centre of gravity of {} | ; write [x, y] for a centre of gravity behind or beside the link
  centre | vector | m | r or centre | centre of gravity, [x, y] in the drawing
  <, along> | direction | | needed | which way it slides, [dx, dy] in the drawing

ground_line: A pin that stays on a line of the ground.
  pin | name | | needed | a pin of a link
  along | direction | | needed | the line's direction in the drawing, not [0, 0]

slot: A pin that stays on a line of a link.
  pin | name | | needed | a pin of another link
  on | name | | needed | the link that has the slot
  along | direction | | needed | the slot's direction in the drawing, not [0, 0]
"""
_EITHER = r"<([^,<>]*), ([^<>]*)>"


def _forms() -> dict[str, Form]:
    """The forms of the table."""
    found: dict[str, Form] = {}
    for part in _TABLE.replace("\n    ", " ").strip().split("\n\n"):
        sides = [re.sub(_EITHER, side, part) for side in (r"\1", r"\2")] if "<" in part else [part]
        for side in sides:
            head, *rows = side.split("\n")
            name, _, told = head.partition(": ")
            keys: dict[str, Key] = {}
            for row in rows:
                key, *rest = (column.strip() for column in row.split("|"))
                if key.startswith("like "):
                    whole, *less = key.removeprefix("like ").replace(" less ", " ").split()
                    keys |= {x: y for x, y in found[whole].keys.items() if x not in less}
                elif key:  # else joints of the other kind alone have it
                    rest += [""] * (6 - len(rest))
                    kind, unit, default, what, symbol, hint = rest
                    listed = kind.endswith("[]")
                    kind = kind.removesuffix("[]")
                    keys[key] = Key(kind, what, unit, default, listed, hint, symbol)
            groups = (tuple(x for x, y in keys.items() if y.default == one) for one in ONE)
            found[name] = Form(told, keys, tuple(filter(None, groups)))
    return found


FORMS = _forms()


def _form_name(kind: str, keys: Container[str]) -> str:
    forms = MAPPINGS.get(kind, {kind: ()})
    return next(form for form, marks in forms.items() if all(x in keys for x in marks))


def form_of(kind: str, keys: Container[str]) -> Form:
    """The form of a mapping of this kind that has these keys."""
    return FORMS[_form_name(kind, keys)]


def excluded(kind: str, keys: Container[str]) -> dict[str, str]:
    """The keys that tell other forms of this kind, each with that which tells the form of these."""
    forms, own = MAPPINGS.get(kind, {kind: ()}), _form_name(kind, keys)
    return {x: y for form in forms if form != own for x in forms[form] for y in forms[own][:1]}
