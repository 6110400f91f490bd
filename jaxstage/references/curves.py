"""Published test contours: the four quadratic NURBS of Mao et al., Energies 2021, 14, 7802.

Table 1 there is in centimetres; these are metres. It lists 15 weights for the star's 13 control
points; all are 1, so 13 ones are meant.
"""

import numpy as np

from jaxstage.references.nurbs import Nurbs, nurbs

HALVES = (0, 0, 0, 0.25, 0.5, 0.5, 0.75, 1, 1, 1)
TENTHS = (0, 0, 0, 0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.8, 1, 1, 1)


def circle() -> Nurbs:
    """An exact circle of radius 25 mm about the origin, from (25, 0) mm, counterclockwise."""
    points = [(2.5, 0), (2.5, 2.5), (-2.5, 2.5), (-2.5, 0), (-2.5, -2.5), (2.5, -2.5), (2.5, 0)]
    return nurbs(np.array(points) / 100, HALVES, (1, 0.5, 0.5, 1, 0.5, 0.5, 1))


def bowknot() -> Nurbs:
    """A figure of eight that crosses itself, smoothly, at the origin."""
    points = [(0, 0), (-1.5, -1.5), (-1.5, 1.5), (0, 0), (1.5, -1.5), (1.5, 1.5), (0, 0)]
    return nurbs(np.array(points) / 100, HALVES, (1, 2.5, 2.5, 1, 2.5, 2.5, 1))


def heart() -> Nurbs:
    """A heart with two corners, 69.984 degrees at u = 0.5 and 52.125 degrees at the closure."""
    points = [(0, 0), (-3, 2), (-2, 5), (0, 3.6), (2, 5), (3, 1), (0, 0)]
    return nurbs(np.array(points) / 100, HALVES)


def star() -> Nurbs:
    """A five-pointed star with two corners of 63.435 degrees, at u = 0.1 and u = 0.8."""
    half = [(0, 6), (-0.5, 6), (-1.5, 4), (-4, 4), (-2, 2), (-2.5, 0), (0, 1.5)]
    other = [(-x, y) for x, y in half[-2::-1]]
    return nurbs(np.array(half + other) / 100, TENTHS)
