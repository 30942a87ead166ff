"""Reference motions: profiles, splines, loops that follow, shortest durations."""
