"""Tools around the simulator: the command line. Imports jaxstage, never the reverse."""
