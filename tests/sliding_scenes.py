"""Scenes with prismatic joints, slots on moving links, and blocks that keep their angle."""

from __future__ import annotations

MIXED = """
gravity: [1.0, -9.81]
links:
  - {name: a, joint: prismatic, axis: [1, 0.5], m: 0.8, l: 0.1, r: [0.03, 0.1], I: 0.002,
     from: [0, 0.1], friction: {force: 0.4, speed: 0.2}}
  - {name: b, m: 0.3, l: 0.4, r: [0.1, 0.02], I: 0.0005, damping: 0.01}
  - {name: c, joint: prismatic, axis: [0, -1], m: 1.5, l: 0.5, r: 0.25, I: 0.03,
     from: {link: b, at: [0.1, 0.2]}, payload: 0.3}
  - {name: d, joint: prismatic, axis: [1, 1], m: 0.7, l: 0.2, r: 0.25, I: 0.02, damping: 0.4}
  - {name: e, m: 0.3, l: 0.2, r: [0.1, 0.02], I: 0.0005, damping: 0.01}
springs:
  - {joint: c, stiffness: 30, length: 0.1, damping: 0.3}
  - {between: [{link: e, at: [0.1, 0.1]}, [0.3, 2]], stiffness: 40, length: 0.4, damping: 1}
  - {between: [{link: d, at: [0.1, 0.1]}, {link: a, at: [0, 0]}], stiffness: 40, length: 0}
loads:
  - {link: d, at: [0.1, 0], force: [3, 1], frame: link}
  - {link: c, torque: 0.4}
  - {link: a, at: [0.1, 0], force: [3, 1], frame: link}
  - {link: e, at: [0.1, 0], force: [3, -1]}
"""

COUPLED = MIXED + 'couplings: ["q3 = 0.2 q2 + 0.1"]\n'

BLOCK = """
gravity: 9.81
links:
  - {name: crank, m: 0.8, l: 0.1, r: 0.03, I: 0.002}
  - {name: block, m: 0.3, l: 0, r: 0.01, I: 0.0005}
  - {name: lever, m: 1.5, l: 0.5, r: 0.25, I: 0.03, from: [0, -0.25]}
closures:
  - {point: {link: block, at: [0, 0]}, on: {link: lever, through: [0, 0.01], along: [1, 0]},
     aligned: 20deg}
actuated: [crank]
"""

SLIDING = """
gravity: 9.81
links:
  - {name: crank, m: 0.8, l: 0.1, r: 0.03, I: 0.002}
  - {name: lever, m: 1.5, l: 0.5, r: 0.25, I: 0.03, from: [0, -0.25]}
  - {name: block, joint: prismatic, axis: [1, 0], m: 0.3, l: 0,
     r: [0.009396926207859084, 0.003420201433256687], I: 0.0005, from: {link: lever, at: [0, 0.01]}}
closures:
  - [crank, {link: block, at: [0, 0]}]
actuated: [crank]
"""

TURNED = """
gravity: 9.81
links:
  - {name: base, joint: prismatic, axis: [1, 2], m: 0.8, l: 0.1, r: 0.03, I: 0.002, from: [0.1, 0]}
  - {name: slide, joint: prismatic, axis: [1, -1], m: 0.8, l: 0.1, r: [0.03, 0.01], I: 0.002}
  - {name: arm, m: 0.3, l: 0.1, r: 0.02, I: 0.0005}
  - {name: out, joint: prismatic, axis: [2, 1], m: 0.3, l: 0.1, r: 0.02, I: 0.0005}
  - {name: fore, joint: prismatic, axis: [2, -1], m: 0.3, l: 0.1, r: [0.02, 0.3], I: 0.0005}
  - {name: other, m: 0.3, l: 0.3, r: 0.02, I: 0.0005, from: [0.5, 0.5]}
  - {name: far, m: 0.3, l: 0.3, r: [0.02, 0.1], I: 0.0005}
closures:
  - {point: other, on: {link: fore, through: [0.1, 0.01], along: [3, -1]}, aligned: 30deg}
couplings: ["q1 = 0.3 q3 - 0.1", "q6 = 2 q4 + 0.2", "q2 = q5"]
"""
SLIDING_SCENES = {"mixed": COUPLED, "block": BLOCK, "sliding block": SLIDING, "turned": TURNED}

# links whose direction is that of nothing somewhere
LEVER = """\
links:
  - {name: crank, m: 0.5, l: 0.2, r: 0.08, I: 0.002}
  - {name: lever, m: 0.7, l: 0.6, r: 0.25, I: 0.02, from: [0.2, 0]}
closures: [{point: crank, on: {link: lever, through: [0, 0], along: [1, 0]}}]
actuated: [crank]
"""
BARREL = """\
links:
  - {name: arm, m: 1, l: 0.5, r: 0.25, I: 0.02}
  - {name: barrel, m: 1, l: 0, r: 0, I: 0.01, from: [0.5, 0]}
  - {name: rod, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0.01}
closures: [[arm, rod]]
actuated: [arm]
"""
SCISSORS = """\
gravity: 9.81
links:
  - {name: armA, m: 1, l: 1.6, r: 0, I: 1}
  - {name: table, m: 1, l: 1.6, r: 0.8, I: 1}
  - {name: armB, from: "armA@0.8,0", m: 1, l: 0.8, r: 0, I: 1}
closures:
  - {point: "armB@0.8,0", on: {through: [0, 0], along: [1, 0]}}
  - {point: "armB@-0.8,0", on: {link: table, through: [0, 0], along: [1, 0]}}
actuated: [armA]
"""
STARTED = "start: {armA: 30deg, table: 150deg, armB: -60deg}\n"
