"""Control laws, one file each, and the functions that compose them."""

from jaxstage.controllers.cascade import Cascade as Cascade
from jaxstage.controllers.cascade import cascade as cascade
from jaxstage.controllers.cmac_sliding import CmacSliding as CmacSliding
from jaxstage.controllers.cmac_sliding import cmac_sliding as cmac_sliding
from jaxstage.controllers.compose import Both as Both
from jaxstage.controllers.compose import Coupled as Coupled
from jaxstage.controllers.compose import Offset as Offset
from jaxstage.controllers.compose import cross_coupled as cross_coupled
from jaxstage.controllers.compose import offset_setpoint as offset_setpoint
from jaxstage.controllers.compose import per_axis as per_axis
from jaxstage.controllers.compose import plus as plus
from jaxstage.controllers.parts.cmac import Gaussian as Gaussian
from jaxstage.controllers.parts.cmac import crisp as crisp
from jaxstage.controllers.parts.cmac import gaussian as gaussian
from jaxstage.controllers.parts.nominal import RigidAxis as RigidAxis
from jaxstage.controllers.pi import Pi as Pi
from jaxstage.controllers.pi import pi as pi
from jaxstage.controllers.sliding import Sliding as Sliding
from jaxstage.controllers.sliding import sliding as sliding
