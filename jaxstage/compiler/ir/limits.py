"""Sizes that several passes must agree on."""

#: fewer cells are no long array
LONG = 32
