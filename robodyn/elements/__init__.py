"""Elements that act on the links of a mechanism; each kind is declared once."""
