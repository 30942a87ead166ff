"""Poses at rest, small motions around them, and feedback gains that keep a pose."""
