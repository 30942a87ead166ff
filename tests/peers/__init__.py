"""The same scenes in engines that others wrote: `make peers`.

One module an engine, `*_peer.py`.  Each builds its own model from a scene's description, by its own
means, and offers what it can of

    terms(mechanism)                {"M": f(q), "G": f(q), "bias": f(q, qd), "tau": f(q, qd, qdd),
                                     "qdd": f(q, qd)} of one state
    batches(tree, q, qd, qdd)       {how: Run} inverse dynamics of all rows
    runs(case, tolerances)          {how: [Run, ...]} of the motion of a Case, from loose to tight
    exported(mechanism)             what `robodyn export` writes, loaded; its terms() as above

and raises NotImplementedError where it does not serve.  M, G and bias = C qd + G are those of the
tree that opened closures leave; "tau" and "qdd" (without torques) are those of the mechanism.
"""
