"""The mechanics of a scene: its constants, and its equations of motion as rows of a program."""
