"""What acts on the links of a mechanism: each kind declared once."""
