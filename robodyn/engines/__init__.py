"""What evaluates recorded formulas: Python text, arrays, machine code."""
