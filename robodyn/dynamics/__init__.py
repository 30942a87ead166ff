"""Matrices, inverse and forward dynamics, reactions, energies, and the identities they keep."""
