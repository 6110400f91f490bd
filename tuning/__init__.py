"""Tools around the simulator: command line, sweeps. Imports jaxstage, never the reverse."""
