"""Online metrics, windows and recording.

Every report field has a name that is unique in the library, so that reports flatten into one
table: the field's name plus its unit is the key of the JSON output and of table columns.
"""

from jaxstage.metrics.adaptation import adapted as adapted
from jaxstage.metrics.between import between as between
from jaxstage.metrics.change import command_change as command_change
from jaxstage.metrics.contour import contour as contour
from jaxstage.metrics.contour import tangent_contour as tangent_contour
from jaxstage.metrics.contour_gains import contour_gains as contour_gains
from jaxstage.metrics.drive import drive as drive
from jaxstage.metrics.drive import drive_following as drive_following
from jaxstage.metrics.drive import recorded_drive_error as recorded_drive_error
from jaxstage.metrics.effort import effort as effort
from jaxstage.metrics.effort import saturation as saturation
from jaxstage.metrics.energy import energy as energy
from jaxstage.metrics.reaching import reaching_gain as reaching_gain
from jaxstage.metrics.sliding import sliding_figures as sliding_figures
from jaxstage.metrics.spectrum import high_frequency as high_frequency
from jaxstage.metrics.spectrum import periodogram as periodogram
from jaxstage.metrics.spectrum import recorded_command as recorded_command
from jaxstage.metrics.spectrum import variance_above as variance_above
from jaxstage.metrics.standard import standard as standard
from jaxstage.metrics.table import columns as columns
from jaxstage.metrics.tracking import following as following
from jaxstage.metrics.tracking import quadrant_glitch as quadrant_glitch
from jaxstage.metrics.tracking import tracking as tracking
from jaxstage.metrics.windows import record as record
from jaxstage.metrics.windows import selected as selected
from jaxstage.metrics.windows import together as together
from jaxstage.metrics.windows import windowed as windowed
