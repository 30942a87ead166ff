"""What notebooks and scripts call: the commands as functions, and how results show themselves."""
