"""Springs with laws and loads that vary: added to random scenes, and what they are to 30 digits.

Expressions are evaluated from their text and tables from their files: nothing of the package is
in what is expected of it.
"""

import csv
import functools
from itertools import pairwise

import yaml
from conftest import ROOT
from mpmath import mp, mpf

from robodyn.scene.scene import Law, Table

TABLES = ROOT / "tests" / "tables"
WORDS = ["sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt"]
AT = 0.45  # s, when such scenes are looked at: within a row of each table


@functools.cache
def cells(file, name, column, precision):
    """Two columns of a table's file, in numbers of so many bits."""
    with open(TABLES / file, encoding="utf-8") as stream:
        return [(mpf(row[name]), mpf(row[column])) for row in csv.DictReader(stream)]


def rows_of(table):
    """The rows of a table's file."""
    name = table.over if table.over in "xt" else f"q{int(table.over[1:]) + 1}"
    return list(cells(table.file.rpartition("/")[2], name, table.column, mp.prec))


def value(signal, **names):
    """A signal where its variables are these; q and qd are lists."""
    q, qd = names.pop("q", []), names.pop("qd", [])
    known = names | {f"q{k + 1}": x for k, x in enumerate(q)}
    known |= {f"qd{k + 1}": x for k, x in enumerate(qd)}
    if isinstance(signal, Law):
        scope = {word: getattr(mp, word) for word in WORDS} | {"pi": mp.pi, "e": mp.e}
        return mpf(eval(signal.text, {"__builtins__": {}}, scope | known))
    assert isinstance(signal, Table)
    x = known[signal.over if signal.over in "xt" else f"q{int(signal.over[1:]) + 1}"]
    rows = rows_of(signal)
    first, last = rows[0][0], rows[-1][0]
    if signal.repeats:
        assert abs(last - first - 2 * mp.pi) < 1e-6
        assert rows[0][1] == rows[-1][1]
        rows[-1] = (first + 2 * mp.pi, rows[-1][1])
        x = x - 2 * mp.pi * mp.floor((x - first) / (2 * mp.pi))
    for (a, A), (b, B) in pairwise(rows):
        if a <= x <= b:
            return A + (B - A) * (x - a) / (b - a)
    raise AssertionError(f"{x} is beyond the table")


def stored(law, x):
    """The integral of a spring's pull from zero to x, by quadrature."""
    ends = [mpf(0), x]
    if isinstance(law, Table):
        low, high = sorted(ends)
        inner = [place for place, _ in rows_of(law) if low < place < high]
        ends = [low, *inner, high] if x >= 0 else [high, *inner[::-1], low]
    return mp.quad(lambda y: value(law, x=y, v=mpf(0)), ends)


def conserves(law):
    """Whether a pull has a potential."""
    return isinstance(law, Table) or "v" not in law.text


def varied(seed, text, n):
    """The text of a scene with such springs and loads of every kind."""
    content = yaml.safe_load(text)
    for closure in content.get("closures", []):
        if True in closure:  # what YAML makes of the key
            closure["on"] = closure.pop(True)
    link = [f"link{(seed + k) % n}" for k in range(4)]
    springs = [
        {
            "between": [{"link": link[0], "at": [0.2, 0.1]}, [1.5, -2.0]],
            "law": "20*x + 8*x**3",
            "length": 0.7,
        },
        {
            "between": [{"link": link[1], "at": [0.1, -0.3]}, [-2.0, 0.5]],
            "law": "5*tanh(2*x) + 0.5*v*sqrt(1 + v**2) + x**2*v",
            "length": 0.4,
        },
        {
            "between": [{"link": link[1], "at": [0.3, 0.2]}, [0.5, 2.5]],
            "table": str(TABLES / "rope.csv"),
            "length": 0.9,
            "damping": 0.7,
        },
        {"joint": link[2], "law": "3*sin(x) + exp(0.1*x)", "angle": 0.3},
        {"joint": link[3], "law": "2*x + 0.2*v**3", "angle": -0.2},
        {"joint": link[0], "table": str(TABLES / "rope.csv"), "angle": 0.5, "damping": 0.1},
    ]
    gas = {"table": str(TABLES / "gas.csv"), "over": "q2" if n > 1 else "t", "column": "F"}
    if n == 1:
        gas = "4*cos(q1)"
    pulses = {"table": str(TABLES / "pulses.csv"), "over": "t", "column": "M"}
    loads = [
        {"link": link[1], "at": [0.4, 0.1], "force": [gas, f"5*sin(3*t) - qd{n}"]},
        {"link": link[2], "at": [0.1, 0.3], "force": [2.5, "exp(-t)*q1"], "frame": "link"},
        {"link": link[3], "torque": pulses},
        {"link": link[0], "torque": "2*cos(q1 - t)/(2 + qd1**2)"},
    ]
    for key, entries in (("springs", springs), ("loads", loads)):
        content[key] = content.get(key, []) + entries
    return yaml.safe_dump(content, sort_keys=False)
