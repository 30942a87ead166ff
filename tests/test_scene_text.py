"""`export --format scene`: what is read back is the same mechanism."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import good_scenes
import numpy as np
import pytest
from conftest import ROOT, Outcome
from test_drawn import FOUR_BAR, Linkage

from random_mechanisms import LOOPS, forced, seeded_scene, seeded_tree
from robodyn.dynamics.closed_form import coriolis_matrix, gravity_vector, mass_matrix, other_forces
from robodyn.export.scene_text import scene_text
from robodyn.loops.closures import closure_jacobian
from robodyn.mechanics.mechanism import Mechanism, build, load
from robodyn.scene.description import from_text
from robodyn.scene.scene_values import read_numbers

Run = Callable[..., Outcome]


def agree(one: Mechanism, other: Mechanism, seed: int = 0) -> None:
    """M, C, G, Psi and Q are the same at a state; Psi alone, if links have no mass."""
    rng = np.random.default_rng(seed)
    start = one.description.start or [None] * one.n
    q = np.array([rng.uniform(-2, 2) if x is None else x for x in start])
    qd = rng.uniform(-2, 2, one.n)
    assert one.massless == other.massless
    terms: list[tuple[Callable[..., Any], tuple[Any, ...]]] = [(closure_jacobian, (q, 0.0))]
    if not one.massless:
        terms += [(mass_matrix, (q,)), (coriolis_matrix, (q, qd)), (gravity_vector, (q,))]
        terms += [(other_forces, (q, qd))]
    for function, state in terms:
        own, its = (function(x, *state) for x in (one, other))
        assert own.shape == its.shape
        assert np.abs(own - its).max(initial=0.0) <= 1e-14 * max(1.0, np.abs(own).max(initial=0.0))
    assert one.actuated == other.actuated
    assert one.description.start == other.description.start
    assert one.description.branches == other.description.branches
    assert one.description.points == other.description.points


def again(mechanism: Mechanism) -> Mechanism:
    return build(from_text(scene_text(mechanism), mechanism.source))


@pytest.mark.parametrize("path", sorted(ROOT.glob("robots/*.yaml")), ids=lambda path: path.stem)
def test_every_example_is_read_back(path: Path) -> None:
    mechanism = load(path)
    agree(mechanism, again(mechanism))


@pytest.mark.parametrize("seed", range(20))
def test_random_scenes_are_read_back(seed: int) -> None:
    texts = [
        seeded_tree(seed, 4).text,
        seeded_scene(seed, [*LOOPS.values()][seed % len(LOOPS)]).text,
    ]
    texts += [forced(seed, seeded_tree(seed, 3)).text]
    for text in texts:
        mechanism = build(from_text(text, "x.yaml"))
        agree(mechanism, again(mechanism), seed)


@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("seed", range(40))
def test_drawn_scenes_become_explicit(seed: int, slides: bool) -> None:
    mechanism = build(from_text(Linkage(seed, slides).drawn(), "x.yaml"))
    text = scene_text(mechanism)
    assert "pins" not in text
    agree(mechanism, again(mechanism), seed)


def test_lengths_of_what_was_drawn_can_be_varied() -> None:
    """What hangs from a tip goes with it, and so do the closures there."""
    text = scene_text(build(from_text(FOUR_BAR, "x.yaml")))
    longer = read_numbers(text, "x.yaml", (("links.crank.l", "0.4"), ("links.rocker.l", "0.9")))
    crank, coupler, rocker = longer.base.links
    assert coupler.hangs_from.at == crank.l == 0.4
    (closure,) = longer.base.closures
    assert closure.second.at == rocker.l == 0.9


@pytest.mark.parametrize("text", [good_scenes.EVERYTHING, good_scenes.LOOP])
def test_every_key_is_read_back(text: str) -> None:
    mechanism = build(from_text(text, "x.yaml"))
    agree(mechanism, again(mechanism))


def test_names_that_yaml_would_not_take() -> None:
    link = "{name: %s, m: 1, l: 1, r: 0.5, I: 1}"
    names = ['"a: b, {c} #d"', "'7'", "yes", "'  spaces '", '"tab\\tand \\"quotes\\""', "ö-µ"]
    text = "name: '#: x'\nlinks: [" + ", ".join(link % name for name in names) + "]\n"
    mechanism = build(from_text(text, "x.yaml"))
    found = again(mechanism)
    assert found.link_names == mechanism.link_names
    assert found.name == mechanism.name


def test_the_command(robodyn: Run, tmp_path: Path) -> None:
    given = robodyn("export", "four-bar", "--format", "scene", "--set", "links.crank.m=0.7")
    assert given.code == 0
    assert given.err == "Note: the comments of the file are left out\n"
    assert "{name: crank, m: 0.7, " in given.out
    plain = tmp_path / "plain.yaml"
    plain.write_text(given.out.partition("name")[1] + given.out.partition("name")[2])
    assert robodyn("export", plain, "--format", "scene").succeeds().out.count("\n") > 5
    robodyn("export", "four-bar", "--format", "scene", "--q", "1").fails(2, "--q", "other tools")


def test_a_scene_with_tables_stays_beside_them(robodyn: Run, tmp_path: Path) -> None:
    (tmp_path / "T.csv").write_text("t,T\n0,1\n1,2\n")
    scene = tmp_path / "arm.yaml"
    load_ = "{link: upper, torque: {table: T.csv, over: t, column: T}}"
    scene.write_text(good_scenes.ARM + f"loads: [{load_}]\n")
    there = tmp_path / "there"
    there.mkdir()
    robodyn("export", scene, "--format", "scene", "-o", tmp_path / "new.yaml").succeeds()
    new = load(tmp_path / "new.yaml")
    agree(load(scene), new)
    told = robodyn("export", scene, "--format", "scene", "-o", there / "new.yaml")
    told.fails(2, "must be in the folder of", "T.csv")
