"""A loop compiled from the jaxpr of one control period. It knows no machine and no law."""
