"""The mechanics of a scene: its numbers, and the one program of rows that every engine runs."""
