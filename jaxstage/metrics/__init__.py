"""Online metrics, windows and recording.

Every report field has a name that is unique in the library, so that reports flatten into one
table: the field's name plus its unit is the key of the JSON output and of table columns.
"""

from jaxstage.metrics.contour import contour as contour
from jaxstage.metrics.contour import tangent_contour as tangent_contour
from jaxstage.metrics.effort import effort as effort
from jaxstage.metrics.effort import saturation as saturation
from jaxstage.metrics.energy import energy as energy
from jaxstage.metrics.sliding import sliding_figures as sliding_figures
from jaxstage.metrics.standard import standard as standard
from jaxstage.metrics.table import columns as columns
from jaxstage.metrics.tracking import following as following
from jaxstage.metrics.tracking import quadrant_glitch as quadrant_glitch
from jaxstage.metrics.tracking import tracking as tracking
from jaxstage.metrics.windows import record as record
from jaxstage.metrics.windows import together as together
from jaxstage.metrics.windows import windowed as windowed
