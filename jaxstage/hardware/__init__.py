"""What stands around a plant: drives, sensors and loads."""

from jaxstage.hardware.drives import Amplified as Amplified
from jaxstage.hardware.drives import CurrentDrive as CurrentDrive
from jaxstage.hardware.drives import CurrentMemory as CurrentMemory
from jaxstage.hardware.drives import amplified as amplified
from jaxstage.hardware.drives import current_drive as current_drive
from jaxstage.hardware.drives import ideal_drive as ideal_drive
from jaxstage.hardware.loads import CouplingLoad as CouplingLoad
from jaxstage.hardware.loads import SineLoad as SineLoad
from jaxstage.hardware.loads import all_loads as all_loads
from jaxstage.hardware.loads import coupling_load as coupling_load
from jaxstage.hardware.loads import no_load as no_load
from jaxstage.hardware.loads import sine_load as sine_load
from jaxstage.hardware.sensors import Encoder as Encoder
from jaxstage.hardware.sensors import EncoderMemory as EncoderMemory
from jaxstage.hardware.sensors import Noisy as Noisy
from jaxstage.hardware.sensors import encoder as encoder
from jaxstage.hardware.sensors import ideal_sensor as ideal_sensor
from jaxstage.hardware.sensors import motor_side as motor_side
from jaxstage.hardware.sensors import noisy as noisy
from jaxstage.hardware.sensors import noisy_encoder as noisy_encoder
