"""The equations of motion of a scene in symbols, and the meaning of their symbols."""
