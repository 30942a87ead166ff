"""What pictures show: charts of columns, mechanisms to scale, maps, in figures and characters."""
