"""From a jaxpr to a graph of scalars."""
