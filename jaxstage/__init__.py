"""Differentiable, batched simulation of CNC feed drives and XY(Z) stages.

    import jaxstage as js

    js.configure(precision="double")
    case = js.build("dfcmac-circle")
    run = case.simulate()
    run.report["contour"].contour_rms

blocks       every signature on one page         signals      what crosses module borders
plants       machines                            controllers  control laws and compositions
references   NURBS curves, timing, motion        loads, sensors, drives
metrics      online figures, windows, recording  studies      published systems, ready to run
rollout      simulate, replay                    batch        rollouts: many runs at once
engine       a loop compiled for this processor  explain      whether it is, and why not
gradients    derivatives, and a check of them    settings     names, TOML files
stability    eigenvalues of one tick             runtime      precision, devices, cache
plot         pictures (imports matplotlib)      testing      the contract of a law, as checks
"""

__version__ = "0.1.0"

from jaxstage.batch import rollouts as rollouts
from jaxstage.blocks import Controller as Controller
from jaxstage.blocks import Drive as Drive
from jaxstage.blocks import Engine as Engine
from jaxstage.blocks import Load as Load
from jaxstage.blocks import Loop as Loop
from jaxstage.blocks import Metric as Metric
from jaxstage.blocks import Plant as Plant
from jaxstage.blocks import Reference as Reference
from jaxstage.blocks import Sensor as Sensor
from jaxstage.blocks import auto as auto
from jaxstage.blocks import compiled as compiled
from jaxstage.blocks import scan as scan
from jaxstage.explain import Explanation as Explanation
from jaxstage.explain import explain as explain
from jaxstage.fields import replace as replace
from jaxstage.gradients import grad_check as grad_check
from jaxstage.gradients import kinks as kinks
from jaxstage.gradients import select as select
from jaxstage.gradients import value_and_gradient as value_and_gradient
from jaxstage.metrics import columns as columns
from jaxstage.metrics import record as record
from jaxstage.metrics import together as together
from jaxstage.metrics import windowed as windowed
from jaxstage.rollout import lost as lost
from jaxstage.rollout import replay as replay
from jaxstage.rollout import simulate as simulate
from jaxstage.runtime import configure as configure
from jaxstage.signals import Carry as Carry
from jaxstage.signals import Measurement as Measurement
from jaxstage.signals import Nearest as Nearest
from jaxstage.signals import Output as Output
from jaxstage.signals import Power as Power
from jaxstage.signals import Run as Run
from jaxstage.signals import Sample as Sample
from jaxstage.signals import Scenario as Scenario
from jaxstage.signals import Setpoint as Setpoint
from jaxstage.signals import Start as Start
from jaxstage.studies import Case as Case
from jaxstage.studies import Timing as Timing
from jaxstage.studies import build as build
from jaxstage.studies import find as find
from jaxstage.studies import loop_names as loop_names
from jaxstage.studies import with_metric as with_metric
