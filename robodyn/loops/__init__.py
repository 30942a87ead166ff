"""Loops: assembling and closing them, their rates, and where they are singular."""
