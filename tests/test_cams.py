"""Cams: the geometry of profiles against closed forms and numbers of 40 digits.

The oracles know no formula of the code: they differentiate the pitch curve, or the support function
of the face's line, by mpmath.
"""

from __future__ import annotations

import math
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from robodyn.dynamics.cams import Follower, contact, convex_radius

mp.mp.dps = 40
H, RISE = 0.02, 2.0  # of each lift: its height and the angle of its rise


def _harmonic(x: Any, m: Any) -> tuple[Any, Any, Any]:
    k = m.pi / RISE
    value = H / 2 * (1 - m.cos(k * x))
    return value, H / 2 * k * m.sin(k * x), H / 2 * k * k * m.cos(k * x)


def _cycloidal(x: Any, m: Any) -> tuple[Any, Any, Any]:
    k = 2 * m.pi / RISE
    value = H * (x / RISE - m.sin(k * x) / (2 * m.pi))
    return value, H / RISE * (1 - m.cos(k * x)), H / RISE * k * m.sin(k * x)


def _polynomial(x: Any, m: Any) -> tuple[Any, Any, Any]:
    u = x / RISE
    value = H * (10 * u**3 - 15 * u**4 + 6 * u**5)
    slope = H / RISE * (30 * u**2 - 60 * u**3 + 30 * u**4)
    return value, slope, H / RISE**2 * (60 * u - 180 * u**2 + 120 * u**3)


LIFTS = [_harmonic, _cycloidal, _polynomial]
THETA = np.linspace(0.03, RISE - 0.03, 23)


def _followers(rng: np.random.Generator) -> dict[str, tuple[Follower, float]]:
    """Of each sort one, with the factor of the lift: m, or rad."""
    u = np.exp(1j * rng.uniform(-3.0, 3.0))
    pivot = complex(*rng.uniform(-0.1, 0.1, 2))
    away = np.exp(1j * rng.uniform(-3.0, 3.0))
    other = np.exp(1j * rng.uniform(-3.0, 3.0))
    hinge = pivot + 0.11 * away
    # a roller's arm that is about square to the line from the cam; a face that passes beside it
    arm = 0.1 * np.exp(1j * 1.95)
    swings = {"turn": other, "pivot": pivot, "joint": hinge, "axis": None}
    to_follower = other.conjugate() * away
    slides = {"turn": u, "pivot": pivot, "axis": u, "joint": pivot + u * (0.04 - 0.007j)}
    return {
        "sliding roller": (Follower(**slides, at=0.002j, radius=0.008, cam_turn=other), 1.0),
        "knife edge": (Follower(**slides, at=0.001 + 0j), 1.0),
        "swinging roller": (Follower(**swings, at=to_follower * arm, radius=0.01), 8.0),
        "sliding face": (Follower(**slides, at=0.003 + 0j, face=np.exp(1.4j)), 1.0),
        "swinging face": (
            Follower(**swings, at=-0.006 * to_follower, face=to_follower * np.exp(2.8j)),
            8.0,
        ),
    }


SORTS = list(_followers(np.random.default_rng(0)))


def _c(z: Any) -> mp.mpc:
    return mp.mpc(complex(z))


def _oracle(follower: Follower, scale: float, lift: Any, x: float) -> dict[str, Any]:
    """The contact at one angle, of 40 digits."""

    def law(theta: Any) -> Any:
        return scale * lift(theta, mp)[0]

    def frame(theta: Any) -> tuple[Any, Any]:
        """The origin and the direction of the follower in the frame of the cam."""
        back = mp.expj(-theta) * mp.conj(_c(follower.cam_turn))
        moved = _c(follower.joint) - _c(follower.pivot)
        if follower.axis is not None:
            return back * (moved + _c(follower.axis) * law(theta)), back * _c(follower.turn)
        return back * moved, back * _c(follower.turn) * mp.expj(law(theta))

    def pitch(theta: Any) -> Any:
        origin, turn = frame(theta)
        return origin + turn * _c(follower.at)

    theta = mp.mpf(x)
    origin, turn = frame(theta)
    if follower.face is None:
        w, w1, w2 = pitch(theta), mp.diff(pitch, theta), mp.diff(pitch, theta, 2)
        normal = 1j * w1 / abs(w1)
        if mp.re(mp.conj(normal) * w) < 0:
            normal = -normal
        profile = w - mp.mpf(follower.radius) * normal
        # the centre of the circle through three near points of the pitch curve, in the limit
        centre = w + 1j * w1 * abs(w1) ** 2 / mp.im(mp.conj(w1) * w2)
        bent = 1 / mp.re(mp.conj(normal) * (w - centre))
        rho = mp.re(mp.conj(normal) * (profile - centre))
        touched = w
    else:

        def support(theta: Any) -> Any:
            """The distance of the line from the cam's joint along its normal."""
            turn = frame(theta)[1]
            return mp.re(mp.conj(1j * turn * _c(follower.face)) * pitch(theta))

        def turned(theta: Any) -> Any:
            return theta if follower.axis is not None else theta - law(theta)

        def slope(theta: Any) -> Any:
            return mp.diff(support, theta) / mp.diff(turned, theta)

        direction = 1j * turn * _c(follower.face)
        p, p1, p2 = support(theta), slope(theta), mp.diff(slope, theta) / mp.diff(turned, theta)
        profile = direction * (p - 1j * p1)  # the normal turns backwards
        normal = direction if p > 0 else -direction
        rho = (p + p2) * (1 if p > 0 else -1)
        bent = 1 / rho
        touched = profile
    # how the point of the follower moves by its own joint
    if follower.axis is not None:
        way = turn / _c(follower.turn) * _c(follower.axis)
    else:
        way = 1j * (touched - origin)
    lever = mp.re(mp.conj(normal) * way)
    out = way if lever > 0 else -way
    return {
        "profile": profile,
        "normal": normal,
        "pressure": mp.arg(normal / out),
        "curvature": 1 / rho,
        "pitch_curvature": bent,
    }


@pytest.mark.parametrize("lift", LIFTS)
@pytest.mark.parametrize("sort", SORTS)
def test_geometry_against_40_digits(sort: str, lift: Any) -> None:
    for seed in range(3):
        follower, scale = _followers(np.random.default_rng(seed))[sort]
        each = lift(THETA, np)
        touch = contact(follower, THETA, *(scale * x for x in each))
        for k, x in enumerate(THETA):
            for name, expected in _oracle(follower, scale, lift, x).items():
                value = complex(getattr(touch, name)[k])
                size = max(1.0, abs(complex(expected)))
                assert abs(value - complex(expected)) < 1e-12 * size, (name, seed, x)
        assert np.all(touch.pressure * touch.pressure < (math.pi / 2) ** 2)


@pytest.mark.parametrize("lift", LIFTS)
def test_textbook_of_a_sliding_roller(lift: Any) -> None:
    """tan of the pressure angle, the pitch curve and its radius, as handbooks have them."""
    R, r, e = 0.03, 0.008, 0.006
    s0 = math.sqrt((R + r) ** 2 - e**2)
    follower = Follower(0j, complex(e, s0), 1j, 0j, radius=r, turn=1j)
    s, s1, s2 = lift(THETA, np)
    touch = contact(follower, THETA, s, s1, s2)
    tangent = (s1 - e) / (s + s0)
    np.testing.assert_allclose(np.tan(touch.pressure), tangent, atol=1e-13)
    x = (s0 + s) * np.sin(THETA) + e * np.cos(THETA)
    y = (s0 + s) * np.cos(THETA) - e * np.sin(THETA)
    np.testing.assert_allclose(touch.pitch, x + 1j * y, atol=1e-15)
    rho = ((s + s0) ** 2 + (s1 - e) ** 2) ** 1.5
    rho /= (s + s0) ** 2 + (s1 - e) * (2 * s1 - e) - (s + s0) * s2
    np.testing.assert_allclose(1.0 / touch.pitch_curvature, rho, rtol=1e-12)
    np.testing.assert_allclose(1.0 / touch.curvature, rho - r, rtol=1e-12)
    np.testing.assert_allclose(np.abs(touch.pitch - touch.profile), r, rtol=1e-13)


@pytest.mark.parametrize("lift", LIFTS)
def test_textbook_of_a_flat_face(lift: Any) -> None:
    """rho = R + s + s'', the contact s' beside the axis, no pressure angle."""
    R = 0.04
    s, s1, s2 = lift(THETA, np)
    touch = contact(Follower(0j, 1j * R, 1j, 0j, face=1 + 0j, turn=1 + 0j), THETA, s, s1, s2)
    np.testing.assert_allclose(1.0 / touch.curvature, R + s + s2, rtol=1e-13)
    np.testing.assert_allclose(touch.along, s1, atol=1e-16)
    x = (R + s) * np.sin(THETA) + s1 * np.cos(THETA)
    y = (R + s) * np.cos(THETA) - s1 * np.sin(THETA)
    np.testing.assert_allclose(touch.profile, x + 1j * y, atol=1e-15)
    assert np.abs(touch.pressure).max() < 1e-15


def test_the_profile_is_touched_by_every_place_of_the_follower() -> None:
    """No point of the roller or of the face lies within the cam, and one lies on it."""
    theta = np.linspace(0.0, 2.0 * np.pi, 2001)
    each = 0.01 * (1 - np.cos(theta)), 0.01 * np.sin(theta), 0.01 * np.cos(theta)
    slides = {"pivot": 0j, "joint": 0.005 + 0.04j, "axis": 1j, "turn": 1j}
    roller = contact(Follower(**slides, at=0j, radius=0.009), theta, *each)
    apart = np.abs(roller.profile[:, None] - roller.pitch[None, ::50])
    np.testing.assert_allclose(apart.min(axis=0), 0.009, rtol=1e-4)
    assert (apart >= 0.009 * (1 - 1e-12)).all()
    face = contact(Follower(**slides, at=0j, face=1j), theta, *each)
    outward = (face.normal[None, ::50].conj() * face.profile[:, None]).real
    on_line = (face.normal[::50].conj() * face.pitch[::50]).real
    assert (outward <= on_line + 1e-15).all()
    np.testing.assert_allclose(outward.max(axis=0), on_line, atol=1e-7)


def test_undercut() -> None:
    """A roller as large as the pitch curve's radius cuts the profile; a hollow meets no face."""
    theta = np.linspace(0.0, 2.0 * np.pi, 721)
    each = 0.02 * (1 - np.cos(2 * theta)), 0.04 * np.sin(2 * theta), 0.08 * np.cos(2 * theta)
    slides = {"pivot": 0j, "joint": 0.04j, "axis": 1j, "turn": 1j, "at": 0j}
    sharp = contact(Follower(**slides), theta, *each)
    least = 1.0 / sharp.pitch_curvature.max()
    for radius, cut in ((0.99 * least, False), (1.01 * least, True)):
        follower = Follower(**slides, radius=radius)
        radii = convex_radius(follower, contact(follower, theta, *each))
        assert (radii.min() < 0.0) == cut
    face = Follower(**{**slides, "joint": 0.039j}, face=1j)
    flat = convex_radius(face, contact(face, theta, *each)) < 0.0
    np.testing.assert_array_equal(flat, 0.039 + each[0] + each[2] < 0.0)
    assert flat.any()


def test_what_does_not_exist_is_nan() -> None:
    still = Follower(0j, 0.1 + 0j, None, 0j, radius=0.01)  # the roller sits on the joint
    touch = contact(still, 0.3, 0.1, 0.2, 0.3)
    assert np.isnan(touch.pressure)
