"""Contents of pictures: charts of columns, mechanisms to scale, maps; in figures and characters."""
