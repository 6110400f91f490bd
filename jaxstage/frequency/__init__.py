"""The frequency view of a loop: linearisation, margins, stiffness, sine sweep.

wrappers    disturbances where a loop is cut     linear     exact linearisation of one period
response    S, L, T, tracking, compliance        margins    gain, phase, delay margin, Ms
sweep       sine sweep of the full loop          analysis   all of it for a case
convert     the model for python-control and scipy
"""

from jaxstage.frequency.analysis import FrequencyView as FrequencyView
from jaxstage.frequency.analysis import answer as answer
from jaxstage.frequency.analysis import margins as margins
from jaxstage.frequency.analysis import operating as operating
from jaxstage.frequency.analysis import view as view
from jaxstage.frequency.analysis import with_sines as with_sines
from jaxstage.frequency.convert import to_control as to_control
from jaxstage.frequency.convert import to_scipy as to_scipy
from jaxstage.frequency.linear import LinearModel as LinearModel
from jaxstage.frequency.linear import linearise as linearise
from jaxstage.frequency.margins import LoopMargins as LoopMargins
from jaxstage.frequency.margins import grid as grid
from jaxstage.frequency.margins import loop_margins as loop_margins
from jaxstage.frequency.response import compliance as compliance
from jaxstage.frequency.response import modal as modal
from jaxstage.frequency.response import response as response
from jaxstage.frequency.response import sensitivity as sensitivity
from jaxstage.frequency.response import tracking as tracking
from jaxstage.frequency.sweep import SineResponse as SineResponse
from jaxstage.frequency.sweep import sine_sweep as sine_sweep
