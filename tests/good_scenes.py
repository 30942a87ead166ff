"""Scenes that are read: a chain, a loop, and one with every key."""

from __future__ import annotations

ARM = """\
name: arm
gravity: 9.81
links:
  - {name: upper, m: 1.5, l: 0.8, r: 0.36, I: 0.082}
  - {name: lower, m: 0.9, l: 0.6, r: 0.25, I: 0.031}
"""

LOOP = """\
name: loop
gravity: 9.81
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
closures:
  - [coupler, rocker]
actuated: [crank]
assembly: open
"""

EVERYTHING = """\
name: everything
gravity: [0.3, -9.7]
links:
  - {name: plate, m: 2.0, l: 0.5, r: [0.21, 0.13], I: 0.05, payload: 0.4, damping: 0.02}
  - {name: left, m: 0.5, l: 0.3, r: 0.14, I: 0.004, from: {link: plate, at: [0.3, 0.2]}}
  - {name: right, m: 0.6, l: 0.4, r: [-0.1, 0], I: 0.007, from: plate}
  - {name: slide, m: 0.7, l: 0.9, r: 0.4, I: 0.06, from: right}
closures:
  - [left, [0.9, 0.1]]
  - {point: {link: slide, at: [0.8, 0.05]}, on: {through: [0, 0.02], along: [3, 4]}}
actuated: [right, plate]
assembly: [crossed, open]
start: {plate: 30deg, right: -pi/4, slide: 0.5}
"""
