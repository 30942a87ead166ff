"""Examples that general tests leave out.

Those of friction by the forces in pins, and of tables, have no equations.  Those without masses
have kinematics alone.  Laws of couplings are no part of oracles, and MJCF refuses them;
`test_laws.py` and `test_equations_laws.py` have tests of their own.
"""

from conftest import ROOT

from robodyn import load

MASSLESS = frozenset(x.stem for x in ROOT.glob("robots/*.yaml") if load(x).massless)
UNWRITTEN = frozenset(("shaper", "recovery-truck")) | MASSLESS
WITH_LAWS = frozenset(("disc-cam", "shaken-pendulum"))
TIMED = frozenset(("lift", "shaken-pendulum"))  # those of the time
