"""The equations of motion of a scene, and what their symbols mean.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

Their entries come from the rows that robodyn computes with (`entries.py`): as formulas to read
(`written.py`), or as recorded arithmetic for code (`recorded.py`).
"""

from robodyn.equations.written import equations as equations
