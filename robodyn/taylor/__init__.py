"""A Taylor-series integrator for planar mechanisms: machine code, and the runs that drive it."""
