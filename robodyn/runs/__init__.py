"""What moves a mechanism: steps of the series in machine code that close, land and leap."""
