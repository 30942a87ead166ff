"""Runs: the integration of motions, their events, contacts, rows and statistics."""
