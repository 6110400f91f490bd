"""Intermediate representation: a graph of scalars, its simplification and intervals."""
