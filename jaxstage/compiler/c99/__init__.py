"""Back end for controllers: plain C99 for one run."""
