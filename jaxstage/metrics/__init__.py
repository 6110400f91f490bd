"""Online metrics, windows and recording.

Every report field has a name that is unique in the library, so that reports flatten into one
table: the field's name plus its unit is the key of the JSON output and of table columns.
"""

from jaxstage.metrics.contour import contour as contour
from jaxstage.metrics.contour import tangent_contour as tangent_contour
from jaxstage.metrics.effort import command_change as command_change
from jaxstage.metrics.effort import effort as effort
from jaxstage.metrics.effort import saturation as saturation
from jaxstage.metrics.energy import energy as energy
from jaxstage.metrics.glitch import drive as drive
from jaxstage.metrics.glitch import quadrant_glitch as quadrant_glitch
from jaxstage.metrics.glitch import tool as tool
from jaxstage.metrics.law_memory import adapted as adapted
from jaxstage.metrics.law_memory import contour_gains as contour_gains
from jaxstage.metrics.law_memory import reaching_gain as reaching_gain
from jaxstage.metrics.law_memory import sliding_metrics as sliding_metrics
from jaxstage.metrics.moments import Moments as Moments
from jaxstage.metrics.moments import moments_of as moments_of
from jaxstage.metrics.spectrum import amplitude_spectrum as amplitude_spectrum
from jaxstage.metrics.spectrum import chattering_amplitude as chattering_amplitude
from jaxstage.metrics.spectrum import drive_chattering as drive_chattering
from jaxstage.metrics.spectrum import high_frequency as high_frequency
from jaxstage.metrics.spectrum import periodogram as periodogram
from jaxstage.metrics.spectrum import recorded_command as recorded_command
from jaxstage.metrics.spectrum import variance_above as variance_above
from jaxstage.metrics.standard import standard as standard
from jaxstage.metrics.table import columns as columns
from jaxstage.metrics.tracking import between as between
from jaxstage.metrics.tracking import drive_error as drive_error
from jaxstage.metrics.tracking import drive_following as drive_following
from jaxstage.metrics.tracking import error_between as error_between
from jaxstage.metrics.tracking import following as following
from jaxstage.metrics.tracking import following_error as following_error
from jaxstage.metrics.tracking import recorded_drive_error as recorded_drive_error
from jaxstage.metrics.tracking import tracking as tracking
from jaxstage.metrics.windows import record as record
from jaxstage.metrics.windows import recorded as recorded
from jaxstage.metrics.windows import selected as selected
from jaxstage.metrics.windows import together as together
from jaxstage.metrics.windows import windowed as windowed
