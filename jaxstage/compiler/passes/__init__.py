"""Passes over a graph: loop rerolling, store forms, specialisation."""
