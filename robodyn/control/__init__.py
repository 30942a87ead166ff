"""Controllers that track a reference motion: the reference, the laws, and how a run asks them."""
