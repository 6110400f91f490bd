"""Differentiable, batched simulation of CNC feed drives and XY(Z) stages.

    import jaxstage as js

    js.configure(precision="double")
    case = js.build("dfcmac-circle")
    run = case.simulate()
    run.report["contour"].contour_rms

model        blocks (every signature on one page), signals, fields, settings, validation
plants       machines                            controllers  control laws and compositions
references   NURBS curves, timing, motion        hardware     drives, sensors, loads
metrics      online metrics, windows, recording  numerics     integrators, kinks, geometry
simulate     one run, many runs, gradients, stability, explain
compiler     a loop compiled for this processor  c_export     a law as C99
studies      published systems, ready to run     plot         run or table -> picture (matplotlib)
testing      the contract of a law, as checks    system       precision, devices, cache, files
"""

__version__ = "0.2.0"

from jaxstage import frequency as frequency
from jaxstage.metrics import columns as columns
from jaxstage.metrics import record as record
from jaxstage.metrics import together as together
from jaxstage.metrics import windowed as windowed
from jaxstage.model.blocks import Controller as Controller
from jaxstage.model.blocks import Drive as Drive
from jaxstage.model.blocks import Engine as Engine
from jaxstage.model.blocks import Load as Load
from jaxstage.model.blocks import Loop as Loop
from jaxstage.model.blocks import Metric as Metric
from jaxstage.model.blocks import Plant as Plant
from jaxstage.model.blocks import Reference as Reference
from jaxstage.model.blocks import Sensor as Sensor
from jaxstage.model.blocks import auto as auto
from jaxstage.model.blocks import compiled as compiled
from jaxstage.model.blocks import scan as scan
from jaxstage.model.fields import replace as replace
from jaxstage.model.signals import Carry as Carry
from jaxstage.model.signals import Measurement as Measurement
from jaxstage.model.signals import Nearest as Nearest
from jaxstage.model.signals import Output as Output
from jaxstage.model.signals import Power as Power
from jaxstage.model.signals import Run as Run
from jaxstage.model.signals import Sample as Sample
from jaxstage.model.signals import Scenario as Scenario
from jaxstage.model.signals import Setpoint as Setpoint
from jaxstage.model.signals import Start as Start
from jaxstage.simulate.batch import rollouts as rollouts
from jaxstage.simulate.explain import Explanation as Explanation
from jaxstage.simulate.explain import explain as explain
from jaxstage.simulate.gradients import grad_check as grad_check
from jaxstage.simulate.gradients import kinks as kinks
from jaxstage.simulate.gradients import select as select
from jaxstage.simulate.gradients import value_and_gradient as value_and_gradient
from jaxstage.simulate.rollout import lost as lost
from jaxstage.simulate.rollout import replay as replay
from jaxstage.simulate.rollout import simulate as simulate
from jaxstage.studies import Case as Case
from jaxstage.studies import Timing as Timing
from jaxstage.studies import build as build
from jaxstage.studies import find as find
from jaxstage.studies import loop_names as loop_names
from jaxstage.studies import with_metric as with_metric
from jaxstage.system.runtime import configure as configure
