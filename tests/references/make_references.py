"""Reference motions of the example scenes, in extended precision: writes the *.json beside it.

    python tests/references/make_references.py             # all, about 4 minutes
    python tests/references/make_references.py 2r-chaotic  # some, by name

Shares no code and no method with the program.  Every mechanism is reduced to its freedoms u: the
links' absolute angles follow from u in closed form (loops are pairs of links between two known
points, or a rod on a line; no constraint and no multiplier is left).  The equation of motion is
Jourdain's principle, summed over the bodies in Cartesian coordinates,

    sum_b  m (sdd - gamma) . ds/du_i + I wd dw/du_i
        =  sum_k tau_k d(q_k)/du_i + sum_springs F . d(first - second)/du_i            for each i

integrated by extrapolation of the midpoint rule (Gragg, Bulirsch, Stoer; Hairer, Norsett, Wanner,
Solving ODEs I, II.9) in mpmath.  Each motion is computed twice, with other digits, order and step;
only the digits on which both agree are written, and at least DIGITS of them are asked for.

Numbers of the scenes and of the starts are the doubles nearest to what is written.  Units are SI
and radians; q_k is relative to the link that k hangs from, counter-clockwise.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import yaml
from mpmath import mp, mpc, mpf

HERE = Path(__file__).resolve().parent
ROBOTS = HERE.parent.parent / "robots"
DIGITS = 18  # significant digits that the two runs must share
MOST_DIGITS = 24  # and at most so many are written


@dataclass(frozen=True)
class Case:
    """A motion of an example scene: the freedoms at t = 0, and the torque of each joint."""

    scene: str
    u: tuple[float, ...]
    ud: tuple[float, ...]
    times: tuple[float, ...]
    note: str
    tau: str = ""  # as `robodyn simulate --tau` would be given it
    torque: Callable | None = None  # the same: t, qd -> torques of all joints


def driven_arm(t, qd):
    return [2 * mp.sin(3 * t), -qd[1] / 2]


def driven_four_bar(t, qd):
    return [mp.sin(2 * t) - mpf(1) / 8 * qd[0], 0, 0]


CASES = {
    "spring-slider-crank": Case(
        "spring-slider-crank", (0.7,), (9.0,), (0.5, 1.0, 2.0), "the crank turns over, then rocks"
    ),
    "balanced-arm": Case(
        "balanced-arm", (0.6, -1.0), (1.5, 0.5), (0.5, 2.0, 5.0), "moves as if there were no weight"
    ),
    "geared-five-bar": Case(
        "geared-five-bar", (1.3,), (0.0,), (0.5, 1.0, 2.0), "falls freely, geared"
    ),
    "2r-regular": Case(
        "2r", (-1.3, -0.2), (0.5, 0.25), (0.5, 2.0, 5.0, 10.0), "swings about hanging"
    ),
    "2r-chaotic": Case(
        "2r", (0.5, 0.75), (1.0, 0.5), (0.5, 2.0, 5.0, 10.0), "falls and turns over"
    ),
    "2r-driven": Case(
        "2r",
        (-1.3, -0.2),
        (0.5, 0.25),
        (0.5, 2.0, 5.0),
        "2r-regular with torques of time and rate",
        "2*sin(3*t), -0.5*qd2",
        driven_arm,
    ),
    "3r": Case("3r", (-1.0, 0.4, -0.3), (0.3, -0.2, 0.5), (0.5, 2.0, 5.0), "swings about hanging"),
    "pendulum": Case("pendulum", (1.0,), (0.0,), (0.5, 2.0, 5.0, 10.0), "a wide swing"),
    "four-bar": Case("four-bar", (1.0,), (5.0,), (0.5, 2.0, 5.0), "the crank turns over"),
    "four-bar-driven": Case(
        "four-bar",
        (1.0,),
        (0.0,),
        (0.5, 2.0, 5.0),
        "from rest with a torque of time and rate",
        "sin(2*t) - 0.125*qd1",
        driven_four_bar,
    ),
    "slider-crank": Case("slider-crank", (0.9,), (8.0,), (0.5, 2.0, 5.0), "the crank turns over"),
    "five-bar": Case("five-bar", (2.1, 1.0), (0.5, -0.4), (0.5, 1.0, 2.0), "falls freely"),
    "watt-six-bar": Case("watt-six-bar", (1.0,), (5.0,), (0.5, 1.0, 2.0), "the crank turns over"),
    "stephenson-six-bar": Case(
        "stephenson-six-bar", (1.0,), (5.0,), (0.5, 1.0, 2.0), "the crank turns over"
    ),
    "hoeken": Case("hoeken", (1.0,), (5.0,), (0.5, 1.0, 2.0), "the crank turns over"),
    "rp-arm": Case("rp-arm", (0.6, 0.25), (0.5, -0.3), (0.25, 0.5, 1.0), "falls, and slides out"),
    "elliptic-trammel": Case(
        "elliptic-trammel", (0.4,), (6.0,), (0.5, 2.0, 5.0), "turns, in a horizontal plane"
    ),
    "whitworth": Case("whitworth", (1.0,), (6.0,), (0.5, 1.0, 2.0), "the crank turns over"),
}


# ---------------------------------------------------------------------------------------------
# Kinematics: angles, rates and accelerations of the links, from those of the freedoms
# ---------------------------------------------------------------------------------------------


class Turning:
    """A link's direction e = exp(i angle), its rates for a unit of each freedom, and its bias.

    rate[i] is d(angle)/du_i; bias is its second derivative in time where udd = 0.  `angle` is a
    function: only output needs it.  Of a link that slides `slid` is its displacement, and d/du_i.
    """

    def __init__(self, angle, e, rate, bias, ud, slid=None):
        self.angle, self.e, self.rate, self.bias = angle, e, rate, bias
        self.w, self.slid = inner(rate, ud), slid


class Point:
    """A moving point: where it is, its slope d(point)/du_i, and its acceleration at udd = 0."""

    def __init__(self, z, slope, bias):
        self.z, self.slope, self.bias = z, slope, bias

    def plus(self, link, at):
        """The point `at` (complex off the axis) of a link whose origin this point is."""
        arm = at * link.e
        across = turned(arm)
        return Point(
            self.z + arm,
            [s + r * across for s, r in zip(self.slope, link.rate, strict=True)],
            self.bias + link.bias * across - link.w**2 * arm,
        )


def fixed(x, y, freedoms):
    return Point(mpc(x, y), [mpc(0)] * freedoms, mpc(0))


def turned(z):
    """i z."""
    return mpc(-z.imag, z.real)


def dot(a, b):
    return a.real * b.real + a.imag * b.imag


def inner(a, b):
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def dyad(a, b, l_a, l_b, ud):
    """The two links from points a and b, of lengths l_a and l_b, whose tips meet left of a to b.

    a + l_a e_a = b + l_b e_b, by the law of cosines.  Differentiated, times the direction along
    the other link, each equation has one unknown.
    """
    z = b.z - a.z
    d = mp.sqrt(dot(z, z))
    cos_a = (d**2 + l_a**2 - l_b**2) / (2 * d * l_a)
    e_a = z / d * mpc(cos_a, mp.sqrt(1 - cos_a**2))
    e_b = (a.z + l_a * e_a - b.z) / l_b
    # i l_a e_a w_a - i l_b e_b w_b = zdot: dot with e_b, and with e_a
    across = dot(turned(e_a), e_b)
    slope = [q - p for p, q in zip(a.slope, b.slope, strict=True)]
    rate_a = [dot(s, e_b) / (l_a * across) for s in slope]
    rate_b = [dot(s, e_a) / (l_b * across) for s in slope]
    w_a, w_b = inner(rate_a, ud), inner(rate_b, ud)
    bend = b.bias - a.bias + l_a * w_a**2 * e_a - l_b * w_b**2 * e_b

    def angle_a():
        return mp.arg(z) + mp.acos(cos_a)

    def angle_b():  # d = l_a cos + l_b cos
        return mp.arg(z) + mp.pi - mp.acos((d - l_a * cos_a) / l_b)

    return (
        Turning(angle_a, e_a, rate_a, dot(bend, e_b) / (l_a * across), ud),
        Turning(angle_b, e_b, rate_b, dot(bend, e_a) / (l_b * across), ud),
    )


def rod_on_line(a, l, height, ud):
    """The rod from point a whose tip slides on the line y = height, the tip to the right of a."""
    s = (height - a.z.imag) / l
    c = mp.sqrt(1 - s**2)
    rate = [-slope.imag / (l * c) for slope in a.slope]
    w = inner(rate, ud)
    return Turning(lambda: mp.asin(s), mpc(c, s), rate, (s * l * w**2 - a.bias.imag) / (l * c), ud)


# ---------------------------------------------------------------------------------------------
# The scenes
# ---------------------------------------------------------------------------------------------


class Scene:
    """A scene's links as bodies, and how their angles follow from the freedoms."""

    def __init__(self, name):
        data = yaml.safe_load((ROBOTS / f"{name}.yaml").read_text())
        self.name = name
        self.gamma = mpc(0, -mpf(data["gravity"]))
        self.links = data["links"]
        for link in self.links:
            for key in ("m", "l", "I"):
                link[key] = mpf(link[key])
            link["r"] = mpc(*link["r"]) if isinstance(link["r"], list) else mpf(link["r"])
        if name.endswith("slider-crank"):
            line = data["closures"][0][True]  # YAML 1.1 reads the key `on` so
            self.height = mpf(line["through"][1])
        freedoms = {"four-bar": 1, "slider-crank": 1, "five-bar": 2}
        freedoms |= {"watt-six-bar": 1, "stephenson-six-bar": 1}
        freedoms |= {"spring-slider-crank": 1, "geared-five-bar": 1}
        freedoms |= {"hoeken": 1, "elliptic-trammel": 1, "whitworth": 1}
        self.springs = data.get("springs", [])
        self.freedoms = freedoms.get(name, len(self.links))

    def unit(self, i):
        return [mpf(i == j) for j in range(self.freedoms)]

    def pose(self, u, ud):
        """The Turning and the origin (a Point) of every link."""
        n, l = self.freedoms, [link["l"] for link in self.links]
        ground = fixed(0, 0, n)

        def free(angle, rate):
            return Turning(lambda: angle, mp.expj(angle), rate, mpf(0), ud)

        if self.name in ("2r", "3r", "pendulum", "balanced-arm"):
            links, origins = [], [ground]
            for k in range(n):
                links.append(free(mp.fsum(u[: k + 1]), [mpf(j <= k) for j in range(n)]))
                origins.append(origins[-1].plus(links[-1], l[k]))
            return links, origins[:-1]
        if self.name in ("rp-arm", "elliptic-trammel", "whitworth"):
            return getattr(self, f"_{self.name.replace('-', '_')}")(u, ud, free)
        crank = free(u[0], self.unit(0))
        tip = ground.plus(crank, l[0])
        if self.name.endswith("slider-crank"):
            return [crank, rod_on_line(tip, l[1], self.height, ud)], [ground, tip]
        pivot = fixed(*self.links[2]["from"], n)
        if self.name == "hoeken":
            coupler, rocker = dyad(tip, pivot, mpf("0.25"), l[2], ud)
            return [crank, coupler, rocker], [ground, tip, pivot]
        if self.name == "four-bar":
            coupler, rocker = dyad(tip, pivot, l[1], l[2], ud)
            return [crank, coupler, rocker], [ground, tip, pivot]
        if self.name.endswith("six-bar"):
            coupler, rocker = dyad(tip, pivot, l[1], l[2], ud)
            at = [mpc(*link["from"]["at"]) for link in self.links[3:] if "at" in link["from"]]
            begin = tip.plus(coupler, at[0])
            if self.name == "watt-six-bar":
                end = pivot.plus(rocker, at[1])
            else:
                end = fixed(*self.links[4]["from"], n)
            rods = dyad(begin, end, l[3], l[4], ud)
            return [crank, coupler, rocker, *rods], [ground, tip, pivot, begin, end]
        if self.name == "geared-five-bar":  # q3 = -2 q1 + 110deg
            right = free(-2 * u[0] + mp.radians(110), [mpf(-2)])
        else:
            assert self.name == "five-bar"
            right = free(u[1], self.unit(1))
        far = pivot.plus(right, l[2])
        left_rod, right_rod = dyad(tip, far, l[1], l[3], ud)
        return [crank, left_rod, right, right_rod], [ground, tip, pivot, far]

    def _rp_arm(self, u, ud, free):
        """The boom's origin is u_2 along the shoulder."""
        shoulder = free(u[0], self.unit(0))
        boom = free(u[0], self.unit(0))
        boom.slid = u[1], self.unit(1)
        e, across, w = boom.e, turned(boom.e), shoulder.w
        bias = 2 * w * ud[1] * across - w**2 * u[1] * e
        return [shoulder, boom], [fixed(0, 0, 2), Point(u[1] * e, [u[1] * across, e], bias)]

    def _elliptic_trammel(self, u, ud, free):
        """x = -l cos u, y = l sin u."""
        l, (c, s), w = self.links[1]["l"], (mp.cos(u[0]), mp.sin(u[0])), ud[0]
        x = free(mpf(0), [mpf(0)])
        x.slid = -l * c, [l * s]
        bar = free(u[0], self.unit(0))
        y = Turning(lambda: mpf(0), mpc(0, 1), [mpf(0)], mpf(0), ud, (l * s, [l * c]))
        begin = Point(mpc(-l * c, 0), [mpc(l * s, 0)], mpc(l * c * w**2, 0))
        end = Point(mpc(0, l * s), [mpc(0, l * c)], mpc(0, -l * s * w**2))
        return [x, bar, y], [begin, begin, end]

    def _whitworth(self, u, ud, free):
        """The lever points from its pivot at the crank's pin; a rod from it moves the ram."""
        l = [link["l"] for link in self.links]
        crank, pivot = free(u[0], self.unit(0)), fixed(*self.links[1]["from"], 1)
        tip = fixed(0, 0, 1).plus(crank, l[0])
        z = tip.z - pivot.z
        d = mp.sqrt(dot(z, z))
        e = z / d
        rate = [dot(slope, turned(e)) / d for slope in tip.slope]
        w, out = inner(rate, ud), dot(inner(tip.slope, ud), e)

        def angle():  # it turns with the crank
            return u[0] + mp.arg(z / crank.e)

        lever = Turning(angle, e, rate, (dot(tip.bias, turned(e)) - 2 * w * out) / d, ud)
        back = pivot.plus(lever, mpf(self.links[2]["from"]["at"][0]))
        x, height = map(mpf, self.links[3]["from"])
        rod = rod_on_line(back, l[2], height, ud)
        end = back.plus(rod, l[2])
        ram = free(mpf(0), [mpf(0)])
        ram.slid = end.z.real - x, [slope.real for slope in end.slope]
        return [crank, lever, rod, ram], [fixed(0, 0, 1), pivot, back, end]

    @property
    def below(self):
        """The link that each hangs from."""
        return {
            "four-bar": [None, 0, None],
            "slider-crank": [None, 0],
            "spring-slider-crank": [None, 0],
            "geared-five-bar": [None, 0, None, 2],
            "hoeken": [None, 0, None],
            "elliptic-trammel": [None, 0, None],
            "whitworth": [None, None, 1, None],
            "five-bar": [None, 0, None, 2],
            "watt-six-bar": [None, 0, None, 1, 2],
            "stephenson-six-bar": [None, 0, None, 1, None],
        }.get(self.name, [None, *range(self.freedoms - 1)])

    def slopes(self, links):
        """dq/du of each joint, which is a difference of absolute angles."""
        return [
            link.slid[1]
            if link.slid
            else link.rate
            if parent is None
            else [r - s for r, s in zip(link.rate, links[parent].rate, strict=True)]
            for link, parent in zip(links, self.below, strict=True)
        ]

    def angles(self, links):
        """q."""
        return [
            link.slid[0]
            if link.slid
            else link.angle() - (0 if parent is None else links[parent].angle())
            for link, parent in zip(links, self.below, strict=True)
        ]

    def acceleration(self, t, u, ud, torque):
        """udd."""
        links, origins = self.pose(u, ud)
        n = self.freedoms
        M = [[mpf(0)] * n for _ in range(n)]
        right = [mpf(0)] * n
        if torque is not None:
            slopes = self.slopes(links)
            tau = torque(t, [inner(slope, ud) for slope in slopes])
            for value, slope in zip(tau, slopes, strict=True):
                right = [x + value * s for x, s in zip(right, slope, strict=True)]
        for link, origin, body in zip(links, origins, self.links, strict=True):
            masses = [(body["m"], body["r"], body["I"])]
            if "payload" in body:  # a body of its own
                masses.append((mpf(body["payload"]), body["l"], mpf(0)))
            for m, r, I in masses:
                s = origin.plus(link, r)
                force = m * (s.bias - self.gamma)
                moment = I * link.bias
                for i in range(n):
                    right[i] -= dot(force, s.slope[i]) + moment * link.rate[i]
                    for j in range(i, n):
                        M[i][j] += m * dot(s.slope[i], s.slope[j]) + I * link.rate[i] * link.rate[j]
        for spring in self.springs:
            ends = [self.end(place, links, origins) for place in spring["between"]]
            d = ends[0].z - ends[1].z
            slope = [p - q for p, q in zip(ends[0].slope, ends[1].slope, strict=True)]
            s = mp.sqrt(dot(d, d))
            speed = dot(d, mp.fsum(p * v for p, v in zip(slope, ud, strict=True))) / s
            pull = mpf(spring["stiffness"]) * (s - mpf(spring["length"]))
            pull += mpf(spring.get("damping", 0)) * speed
            for i in range(n):
                right[i] -= pull / s * dot(d, slope[i])
        return cholesky_solve(M, right)

    def end(self, place, links, origins):
        """A point as a scene writes it."""
        if isinstance(place, list):
            return fixed(*place, self.freedoms)
        names = [link["name"] for link in self.links]
        if isinstance(place, str):
            k = names.index(place)
            return origins[k].plus(links[k], self.links[k]["l"])
        k = names.index(place["link"])
        return origins[k].plus(links[k], mpc(*place["at"]))


def cholesky_solve(M, b):
    """x of M x = b for a symmetric positive definite M given by its upper triangle (LDL^T)."""
    n = len(b)
    L = [[mpf(0)] * n for _ in range(n)]
    D = [mpf(0)] * n
    for j in range(n):
        D[j] = M[j][j] - sum(L[j][k] ** 2 * D[k] for k in range(j))
        for i in range(j + 1, n):
            L[i][j] = (M[j][i] - sum(L[i][k] * L[j][k] * D[k] for k in range(j))) / D[j]
    x = list(b)
    for i in range(n):
        x[i] -= sum(L[i][k] * x[k] for k in range(i))
    x = [value / d for value, d in zip(x, D, strict=True)]
    for i in reversed(range(n)):
        x[i] -= sum(L[k][i] * x[k] for k in range(i + 1, n))
    return x


# ---------------------------------------------------------------------------------------------
# Extrapolated midpoint rule
# ---------------------------------------------------------------------------------------------


def step(f, t, y, h, columns):
    """y at t + h by Gragg's midpoint rule in 2, 4, .. 2 columns parts, extrapolated in h^2.

    And an error: how far the last extrapolation moved it.
    """
    row: list = []
    first = f(t, y)
    for k in range(1, columns + 1):
        parts = 2 * k
        small = h / parts
        before, now = y, [a + small * d for a, d in zip(y, first, strict=True)]
        for i in range(1, parts):
            rate = f(t + i * small, now)
            before, now = now, [a + 2 * small * d for a, d in zip(before, rate, strict=True)]
        new = [now]
        for j, coarse in enumerate(row):
            weight = (mpf(k) / (k - 1 - j)) ** 2 - 1
            fine = new[-1]
            new.append([x + (x - c) / weight for x, c in zip(fine, coarse, strict=True)])
        row = new
    return row[-1], max(abs(a - b) for a, b in zip(row[-1], row[-2], strict=True))


def advance(f, t, y, end, columns, tolerance):
    """y at `end`, by steps whose error is below `tolerance` each."""
    h = mpf(1) / 64  # a long first step may fly off to where angles have millions of digits
    while t < end:
        h = min(h, end - t)
        new, error = step(f, t, y, h, columns)
        if error < tolerance:
            t, y = t + h, new
        grow = (tolerance / max(error, tolerance * mpf("1e-12"))) ** (mpf(1) / (2 * columns - 1))
        h *= min(max(mpf("0.8") * grow, mpf("0.1")), 2)
    return y


def states(case, digits, columns, tolerance):
    """q and qd, in turn, at 0 and the times of the case."""
    with mp.workdps(digits):
        scene = Scene(case.scene)
        n = scene.freedoms

        def f(t, y):
            return [*y[n:], *scene.acceleration(t, y[:n], y[n:], case.torque)]

        t, y = mpf(0), [mpf(x) for x in (*case.u, *case.ud)]
        found = []
        for end in map(mpf, (0.0, *case.times)):
            y = advance(f, t, y, end, columns, mpf(tolerance))
            t = end
            links, _ = scene.pose(y[:n], y[n:])
            rates = [inner(slope, y[n:]) for slope in scene.slopes(links)]
            found.append([*scene.angles(links), *rates])
        return found


# ---------------------------------------------------------------------------------------------
# What is written
# ---------------------------------------------------------------------------------------------

SETTINGS = ((38, 11, "1e-23"), (42, 13, "1e-26"))  # digits, columns, tolerance of a step


def agreed(a, b, size):
    """The number as text with the digits that a and b share; `size` is that of its vector."""
    error = abs(a - b)
    good = MOST_DIGITS if error == 0 else int(mp.floor(-mp.log10(error / size)))
    if good < DIGITS + 1:
        raise ArithmeticError(f"only {good} digits agree: {mp.nstr(a, 25)}, {mp.nstr(b, 25)}")
    # the last digit that agrees may still round either way: one less is written
    shown = min(good - 1, MOST_DIGITS)
    lost = max(0, int(mp.ceil(mp.log10(size / abs(a))))) if a else 0
    return mp.nstr(b, max(shown - lost, 1), strip_zeros=False), shown


def make(name):
    """Compute one motion and write its file."""
    case, begun = CASES[name], time.perf_counter()
    coarse, fine = (states(case, *setting) for setting in SETTINGS)
    rows, least = [], MOST_DIGITS
    with mp.workdps(60):
        for t, a, b in zip((0.0, *case.times), coarse, fine, strict=True):
            half = len(a) // 2
            texts = []
            for part in (slice(None, half), slice(half, None)):
                size = max(max(abs(x) for x in b[part]), mpf(1))
                for x, y in zip(a[part], b[part], strict=True):
                    text, digits = agreed(x, y, size)
                    texts.append(text)
                    least = min(least, digits)
            rows.append({"t": t, "q": texts[:half], "qd": texts[half:]})
    content = {
        "scene": f"robots/{case.scene}.yaml",
        "note": case.note,
        "tau": case.tau,
        "agreed_digits": least,
        "states": rows,
    }
    (HERE / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")
    print(f"{name}: {least} digits agree, {time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    for wanted in sys.argv[1:] or CASES:
        make(wanted)
