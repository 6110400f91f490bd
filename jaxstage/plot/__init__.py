"""Plots of a run: figures with units, settings and the verdict on them.

    from jaxstage import plot

    shown = plot.view(case, run.report["scored"], run.rows["record"])
    plot.contour(shown)

view       a recorded run as plain arrays, ready to draw
contour    the reference and the tool path, contour error magnified
axes       position and following error of each axis
error      contour error against time and along the lap
command    what the drive was asked for, and a closer look at a reversal
weights    what an adaptive law learned
surface    sliding variable and phase plane
space      three axes: the path in space, contour error magnified
schedule   the gains that a cross-coupled law scheduled
pictures   all that apply to a run, as PNG files
VIEWS      the pictures of one run by name
chart      panels of lines or bars computed from a study's evidence
claims     published number, ours and verdict of all claims of a study
sweep, sensitivity, tuning   modules of their own: of a Monte-Carlo sweep, of the effects of its
           uncertain values, of a tuning
memberships, rule_surface   the sets and the rules of a fuzzy system

The only part of the library that imports matplotlib; it uses no global state or style.
"""

from jaxstage.plot.axes import axes as axes
from jaxstage.plot.chart import chart as chart
from jaxstage.plot.claims import claims as claims
from jaxstage.plot.command import command as command
from jaxstage.plot.contour import contour as contour
from jaxstage.plot.error import error as error
from jaxstage.plot.fuzzy import memberships as memberships
from jaxstage.plot.fuzzy import rule_surface as rule_surface
from jaxstage.plot.pictures import VIEWS as VIEWS
from jaxstage.plot.pictures import pictures as pictures
from jaxstage.plot.pictures import save as save
from jaxstage.plot.schedule import schedule as schedule
from jaxstage.plot.space import space as space
from jaxstage.plot.surface import surface as surface
from jaxstage.plot.view import View as View
from jaxstage.plot.view import view as view
from jaxstage.plot.weights import weights as weights
