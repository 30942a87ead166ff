"""The Taylor series of a motion as straight-line code: every coefficient spelled out.

In absolute angles, and each link in the frame in which it starts the step, the unknown is
r_l + i t_l = exp(i (alpha_l - alpha_l,0)).  Its coefficient k + 2 has a radial part, known from
r^2 + t^2 = 1, and a tangential part:

    P_k = (k+1)(k+2) (r + i t)_{k+2},
    r_{k+2} = -1/2 sum_{0<m<k+2} (r_m r_{k+2-m} + t_m t_{k+2-m})
    F_j = sum_l W_jl P_l - conj(E_j) (conj(weight_j) + sum_rows conj(P_row,j) lambda_row)
    r_j Im F_j - t_j Re F_j = tau_j,        Re(sum_l P_row,l E_l P_l) = 0

with W = conj(E) A E at the step's start, whose real part is M.  So what is unknown at order k,
t_{k+2} and lambda_k, enters through the same symmetric matrix [M Psi^T; Psi 0] at every
order: it is factored once a step.  The equation of joint j at order k gives Im F_j,k besides.  An
order costs three convolutions of real series a link (N is two halves); rates cost two more where
dampers or torques ask for their series.

A coupling holds sum_l angles_l w_l = 0 instead, where w_l of order k + 1 is (k+2) t_{k+2} and what
is known; its multiplier is a torque on the joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from robodyn.mechanism import Mechanism
from robodyn.taylor import TINY

# expand(y, h_most, direction, rtol, atol, push) -> h, y at t + h, series: r_0.., t_0.., the power
Expansion = Callable[..., tuple[float, list[float], tuple[tuple[float, ...], ...]]]


def compile_expansion(
    mechanism: Mechanism, order: int, torques: Sequence[float] | None, work: bool
) -> Expansion:
    """The series, that of the rates to `order`, and one step along it.

    `torques` (n) are constant; None: `push(rates)`, given the coefficients of the joint rates of
    one order, returns those of the torques, as `TorqueSeries` does.  With `work` a component for
    the work done by torques less dampers is appended to the state.
    """
    if torques is not None and mechanism.has_state_forces:
        raise ValueError("springs and the like are torques that change: they come by `push`")
    writer = _Writer(mechanism, order, torques, work)
    source = writer.function()
    names: dict[str, Any] = {}
    exec("from math import atan2, cos, inf, isfinite, nan, sin", names)
    exec(compile(source, "<robodyn taylor series>", "exec"), names)
    function: Expansion = names["expand"]
    return function


class _Writer:
    """Writes the function, line by line."""

    def __init__(
        self, mechanism: Mechanism, order: int, torques: Sequence[float] | None, work: bool
    ) -> None:
        self.mechanism, self.order, self.torques, self.work = mechanism, order, torques, work
        self.n, self.rows = mechanism.n, mechanism.rows
        self.damping = mechanism.damping
        self.lines: list[str] = []
        # the terms of F_j: (l, Re A_jl, Im A_jl), its own first
        self.coupling: list[list[tuple[int, float, float]]] = [[] for _ in range(self.n)]
        for j, k, value in sorted(mechanism.A, key=lambda entry: entry[0] != entry[1]):
            self.coupling[j].append((k, value.real, value.imag))
            if j != k:
                self.coupling[k].append((j, value.real, -value.imag))
        self.own = [terms[0][1] for terms in self.coupling]
        self.weight = [(-w.real, w.imag) for w in mechanism.weights]
        self.separate = mechanism.has_state_forces  # whether `push` returns what does work besides
        # the power of constant torques needs no series: their work is tau times the way
        damped = any(self.damping)
        self.moving = torques is None or damped  # whether the series of the rates are wanted
        self.children: list[list[int]] = [[] for _ in range(self.n)]
        for k, above in enumerate(mechanism.parent):
            if above is not None:
                self.children[above].append(k)

    def add(self, line: str) -> None:
        self.lines.append(line)

    def function(self) -> str:
        n = self.n
        names = [f"q{k}" for k in range(n)] + [f"v{k}_0" for k in range(n)]
        self.add(f"{', '.join(names + ['work'] * self.work)}, = y")
        for k in self.mechanism.order:
            above = self.mechanism.parent[k]
            angle, rate = f"q{k}", f"v{k}_0"
            if above is not None:
                angle, rate = f"al{above}+{angle}", f"w{above}_0+{rate}"
            self.add(f"al{k} = {angle}; w{k}_0 = {rate}; C{k} = cos(al{k}); S{k} = sin(al{k})")
            self.add(f"r{k}_0 = 1.0; t{k}_0 = 0.0; r{k}_1 = 0.0; t{k}_1 = w{k}_0")
        self.factor()
        for k in range(self.order):
            self.one_order(k)
        self.finish()
        body = "\n    ".join(self.lines)
        return f"def expand(y, most, direction, rtol, atol, push):\n    {body}\n"

    # -- the system ------------------------------------------------------------------------------

    def factor(self) -> None:
        """L D L^T of [M Psi^T; Psi 0], once a step; without pivoting, as M comes first."""
        n = self.n
        matrix: list[dict[int, str]] = [{} for _ in range(n + len(self.rows))]
        for j, k, value in self.mechanism.A:
            if j == k:
                matrix[j][j] = repr(value.real)
                continue
            self.add(f"x = C{j}*C{k} + S{j}*S{k}; z = C{j}*S{k} - S{j}*C{k}")
            a, b = min(j, k), max(j, k)
            real = [*_term(value.real, "x"), *_term(-value.imag, "z")]
            imaginary = [*_term(value.real, "z"), *_term(value.imag, "x")]
            self.add(f"m{a}_{b} = {_sum(real)}; k{j}_{k} = {_sum(imaginary)}; k{k}_{j} = -k{j}_{k}")
            self.add(f"M{a}_{b} = m{a}_{b}")  # the factorisation changes m
            matrix[a][b] = f"m{a}_{b}"
        for r, row in enumerate(self.rows):
            for k, p in row.P:
                terms = [*_term(-p.real, f"S{k}"), *_term(-p.imag, f"C{k}")]
                self.add(f"m{k}_{n + r} = {_sum(terms)}")
                terms = [*_term(-p.real, f"C{k}"), *_term(p.imag, f"S{k}")]
                self.add(f"k{n + r}_{k} = {_sum(terms)}")
                matrix[k][n + r] = f"m{k}_{n + r}"
            for k, turn in row.angles:
                matrix[k][n + r] = repr(turn)
        self.columns: list[list[int]] = []
        for i in range(n + len(self.rows)):
            pivot = matrix[i].pop(i, None)
            if pivot is None:
                raise ValueError("the closures leave no pivot")
            self.add(f"i{i} = 1.0/({pivot})")
            columns = sorted(matrix[i])
            self.columns.append(columns)
            for place, j in enumerate(columns):
                self.add(f"f{i}_{j} = {matrix[i][j]}*i{i}")
                for k in columns[place:]:
                    before = matrix[j].get(k)
                    product = f"f{i}_{j}*{matrix[i][k]}"
                    self.add(f"m{j}_{k} = {'' if before is None else before} - {product}")
                    matrix[j][k] = f"m{j}_{k}"

    def solve(self, right: list[str], names: list[str]) -> None:
        """Solve for `names`; what belongs to closures is called l and has the sign of -lambda."""
        names = names + [f"l{r}" for r in range(len(self.rows))]
        for name, value in zip(names, right, strict=True):
            self.add(f"{name} = {value}")
        for i, name in enumerate(names):
            for j in self.columns[i]:
                self.add(f"{names[j]} -= f{i}_{j}*{name}")
        for i, name in reversed(list(enumerate(names))):
            terms = "".join(f" - f{i}_{j}*{names[j]}" for j in self.columns[i])
            self.add(f"{name} = {name}*i{i}{terms}")

    # -- one order -------------------------------------------------------------------------------

    def one_order(self, k: int) -> None:
        """From r, t of orders 0..k+1 to those of order k + 2."""
        n = self.n
        torques = self.joint_torques(k)
        scale = float((k + 1) * (k + 2))
        for j in range(n):
            radial = " + ".join(_half_square(f"{x}{j}_", k + 2) for x in ("t", "r"))
            self.add(f"r{j}_{k + 2} = -({radial})")
        right = []
        for j in range(n):
            # Im F of order k, by the equation of the joint
            terms = [torques[j]] if torques[j] else []
            if k:
                terms.append(_convolution(f"t{j}_", f"Fx{j}_", 1, k, k))
            if k > 1:
                terms.append("-" + _convolution(f"r{j}_", f"Fy{j}_", 2, k, k).replace("+", "-"))
            self.add(f"Fy{j}_{k} = {_sum(terms)}")
            terms = [f"Fy{j}_{k}*{1 / scale!r}"]
            terms += [f"-k{j}_{other}*r{other}_{k + 2}" for other, _, _ in self.coupling[j][1:]]
            if k == 0:
                x, y = self.weight[j]
                terms += [*_term(-0.5 * y, f"C{j}"), *_term(0.5 * x, f"S{j}")]
            right.append(_sum(terms))
        for r, row in enumerate(self.rows):
            terms = [f"k{n + r}_{j}*r{j}_{k + 2}" for j, _ in row.P]
            terms += [f"{-a / (k + 2)!r}*({_rate(j, k + 1, k)})" for j, a in row.angles]
            right.append(_sum(terms))
        self.solve(right, [f"t{j}_{k + 2}" for j in range(n)])
        for r, row in enumerate(self.rows):
            for j, a in row.angles:
                self.add(f"Fy{j}_{k} -= {a * scale!r}*l{r}")
        if k + 1 < self.order:
            for j in range(n):
                self.force(j, k, scale)
        if self.moving:
            self.rates(k + 1)

    def rates(self, k: int) -> None:
        """w = r t' - t r' of order k, and the joints' own rates."""
        for j in range(self.n):
            self.add(f"w{j}_{k} = {_rate(j, k, k)}")
        for j, above in enumerate(self.mechanism.parent):
            self.add(f"v{j}_{k} = w{j}_{k}" + ("" if above is None else f" - w{above}_{k}"))

    def joint_torques(self, k: int) -> list[str]:
        """J^-T (tau - D qd) of order k, in absolute angles."""
        own: list[list[str]] = []
        if self.torques is None:
            rates = ", ".join(f"v{j}_{k}" for j in range(self.n))
            self.push(k, rates)
        for j in range(self.n):
            terms = []
            if self.torques is None:
                terms.append(f"u{j}_{k}")
            elif k == 0 and self.torques[j]:
                terms.append(repr(self.torques[j]))
            if self.damping[j]:
                terms.append(f"{-self.damping[j]!r}*v{j}_{k}")
            own.append(terms)
        result = []
        for j in range(self.n):
            terms = list(own[j])
            terms += [f"-({term})" for child in self.children[j] for term in own[child]]
            if k == 0 and self.mechanism.moments[j]:
                terms.append(repr(self.mechanism.moments[j]))
            result.append(_sum(terms) if terms else "")
        return result

    def push(self, k: int, rates: str) -> None:
        """u, the torques of order k, and g, those whose work changes the energy."""
        kinds = "ug" if self.separate else "u"
        names = ", ".join(f"{kind}{j}_{k}" for kind in kinds for j in range(self.n))
        self.add(f"{names}, = push(({rates},))")

    def force(self, j: int, k: int, scale: float) -> None:
        """Re F_j of order k."""
        terms = [f"{self.own[j]!r}*r{j}_{k + 2}"]
        for other, _, _ in self.coupling[j][1:]:
            a, b = min(j, other), max(j, other)
            terms.append(f"M{a}_{b}*r{other}_{k + 2} - k{j}_{other}*t{other}_{k + 2}")
        for r, row in enumerate(self.rows):
            if any(link == j for link, _ in row.P):
                terms.append(f"-k{self.n + r}_{j}*l{r}")
        total = [f"{scale!r}*({_sum(terms)})"]
        if k == 0:
            x, y = self.weight[j]
            total += [*_term(x, f"C{j}"), *_term(y, f"S{j}")]
        self.add(f"Fx{j}_{k} = {_sum(total)}")

    # -- the step --------------------------------------------------------------------------------

    def finish(self) -> None:
        """The step from the last two coefficients, and the state at its end."""
        n, p = self.n, self.order

        def largest(k: int) -> str:  # the square of the largest coefficient k
            sizes = [f"r{j}_{k}*r{j}_{k} + t{j}_{k}*t{j}_{k}" for j in range(n)]
            return f"max({', '.join(sizes)})" if n > 1 else sizes[0]

        rates = [f"abs(w{j}_0)" for j in range(n)]
        self.add(f"fast = max({', '.join(rates)})" if n > 1 else f"fast = {rates[0]}")
        self.add(f"last = {largest(p + 1)}; before = {largest(p)}")
        # max may pass over a nan; links on trees of their own need not share it
        tails = " + ".join(f"t{j}_{p + 1}" for j in range(n))
        self.add(f"if not isfinite(last + before + {tails}): return 0.0, y, ()")
        # what a rate may miss; of two orders, as every other coefficient may vanish
        self.add("tol = atol + rtol*fast")
        self.add(f"h = (tol*tol/({(p + 1.0) ** 2!r}*last or {TINY}))**{0.5 / p!r}")
        self.add(f"x = (tol*tol/({float(p * p)!r}*before or {TINY}))**{0.5 / (p - 1)!r}")
        self.add("if x < h: h = x")
        self.add("if h*fast > 2.0: h = 2.0/fast")  # more turns than one may not be counted
        self.add("if h > most: h = most")
        angle = f"{p + 1.0!r}*(atol + rtol)"
        self.add(f"if h*tol > {angle}: h *= ({angle}/(h*tol))**{1 / (p + 1)!r}")
        self.add("x = h*direction")
        for j in range(n):
            # w = t'/r = -r'/t: the derivative of one of the two, chosen by the turn to come
            for test, main, other in (
                (f"if -0.8 < x*w{j}_0 < 0.8:", "t", "r"),
                ("else:", "r", "t"),
            ):
                steps = [f"{main} = {main}{j}_{p + 1}; d = 0.0; {other} = {other}{j}_{p + 1}"]
                for k in reversed(range(p + 1)):
                    steps.append(
                        f"d = d*x + {main}; {main} = {main}*x + {main}{j}_{k}; "
                        f"{other} = {other}*x + {other}{j}_{k}"
                    )
                steps.append(f"e{j} = {'d/r' if main == 't' else '-d/t'}")
                self.lines += [test, *(f"    {step}" for step in steps)]
            self.add(f"d{j} = atan2(t, r)")
        q, v, way = [], [], []
        for j, above in enumerate(self.mechanism.parent):
            way.append(f"d{j}" if above is None else f"(d{j} - d{above})")
            q.append(f"q{j} + {way[j]}")
            v.append(f"e{j}" if above is None else f"e{j} - e{above}")
        series = [
            f"({', '.join(f'{z}{j}_{k}' for k in range(p + 2))})" for z in "rt" for j in range(n)
        ]
        done = []
        if self.work and self.moving:
            self.power()
            series.append(f"({', '.join(f'p_{k}' for k in range(p + 1))}, 0.0)")
            self.add(f"d = p_{p}*{1.0 / (p + 1)!r}")
            for k in reversed(range(p)):
                self.add(f"d = d*x + p_{k}*{1.0 / (k + 1)!r}")
            done = ["work + x*d"]
        elif self.work and self.torques is not None:
            terms = [f"{tau!r}*{way[j]}" for j, tau in enumerate(self.torques) if tau]
            done = [f"work + {_sum(terms)}"]
        self.add(f"return h, [{', '.join(q + v + done)}], ({', '.join(series)},)")

    def power(self) -> None:
        """The series of the power of torques less dampers."""
        p = self.order
        working = "g" if self.separate else "u"
        if self.torques is None:  # the torques of the last order are not needed elsewhere
            rates = ", ".join(f"v{j}_{p}" for j in range(self.n))
            self.push(p, rates)
        for k in range(p + 1):
            terms = []
            for j in range(self.n):
                if self.torques is None:
                    terms.append(_convolution(f"{working}{j}_", f"v{j}_", 0, k, k))
                elif self.torques[j]:
                    terms.append(f"{self.torques[j]!r}*v{j}_{k}")
                if self.damping[j]:
                    square = _convolution(f"v{j}_", f"v{j}_", 0, k, k)
                    terms.append(f"{-self.damping[j]!r}*({square})")
            self.add(f"p_{k} = {_sum(terms)}")


def _rate(j: int, k: int, last: int) -> str:
    """The terms m up to `last` of w_j of order k, of r t' - t r'."""
    terms = [
        f"{m + 1.0!r}*(r{j}_{k - m}*t{j}_{m + 1} - t{j}_{k - m}*r{j}_{m + 1})"
        for m in range(last + 1)
    ]
    return _sum(terms)


def _convolution(a: str, b: str, first: int, last: int, total: int) -> str:
    """sum of a_m b_{total-m} for m from first to last."""
    return " + ".join(f"{a}{m}*{b}{total - m}" for m in range(first, last + 1))


def _half_square(a: str, total: int) -> str:
    """1/2 sum of a_m a_{total-m} for 0 < m < total."""
    terms = [f"{a}{m}*{a}{total - m}" for m in range(1, (total + 1) // 2)]
    if total % 2 == 0:
        terms.append(f"0.5*{a}{total // 2}*{a}{total // 2}")
    return " + ".join(terms)


def _term(weight: float, name: str) -> list[str]:
    """weight*name, or nothing."""
    if weight == 0.0:
        return []
    if abs(weight) == 1.0:
        return [name if weight > 0.0 else f"-{name}"]
    return [f"{weight!r}*{name}"]


def _sum(terms: Sequence[str]) -> str:
    return " + ".join(terms).replace("+ -", "- ") if terms else "0.0"
