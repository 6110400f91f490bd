"""A controller as C99, with its gains, units and a replay of a run."""
