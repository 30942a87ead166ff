"""The equations of motion of a scene, and what their symbols mean."""
