"""Events of a run: where functions of the motion change sign, none missed."""
