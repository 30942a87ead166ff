"""What a program of rows consists of, and expressions as rows."""
