"""The numbers of a mechanism from data: what its torques are linear in, and estimates of it."""
