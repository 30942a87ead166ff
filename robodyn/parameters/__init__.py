"""The numbers of a scene from data: what torques are linear in, estimates, and fits of columns."""
