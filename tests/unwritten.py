"""Examples that general tests leave out.

Those of friction by the forces in pins have no equations.  Laws of couplings are no part of
oracles, and MJCF refuses them; `test_laws.py` and `test_equations_laws.py` have tests of their own.
"""

UNWRITTEN = frozenset(("shaper",))
WITH_LAWS = frozenset(("disc-cam", "shaken-pendulum"))
TIMED = frozenset(("shaken-pendulum",))  # those of the time
