"""Studies made of the rooms below: presets, the maze comparison, the report."""
