"""Reference trajectories (commanded motions). Table of contents.

A curve (`Nurbs`; `circle`, `bowknot`, `heart`, `star` are published ones) and a timing
(`uniform_parameter`, `constant_feed`) make a stored lap (`make_path`), which `sampled` follows.
`analytic`, `helical`, `swinging`, `stepping`, `trifolium` and `nurbs_lap` compute the motion inside
the tick instead.
"""

from jaxstage.references.curves import bowknot as bowknot
from jaxstage.references.curves import circle as circle
from jaxstage.references.curves import heart as heart
from jaxstage.references.curves import star as star
from jaxstage.references.helix import Helix as Helix
from jaxstage.references.helix import helical as helical
from jaxstage.references.helix import helix as helix
from jaxstage.references.motion import analytic as analytic
from jaxstage.references.motion import nurbs_lap as nurbs_lap
from jaxstage.references.nurbs import Nurbs as Nurbs
from jaxstage.references.nurbs import derivatives as derivatives
from jaxstage.references.nurbs import evaluate as evaluate
from jaxstage.references.nurbs import is_closed as is_closed
from jaxstage.references.nurbs import nurbs as nurbs
from jaxstage.references.nurbs import points as points
from jaxstage.references.one_axis import StepMotion as StepMotion
from jaxstage.references.one_axis import Swing as Swing
from jaxstage.references.one_axis import step as step
from jaxstage.references.one_axis import stepping as stepping
from jaxstage.references.one_axis import swing as swing
from jaxstage.references.one_axis import swinging as swinging
from jaxstage.references.path import Path as Path
from jaxstage.references.path import make_path as make_path
from jaxstage.references.path import mean_feed as mean_feed
from jaxstage.references.path import sampled as sampled
from jaxstage.references.timing import constant_feed as constant_feed
from jaxstage.references.timing import uniform_parameter as uniform_parameter
from jaxstage.references.trifolium import Trifolium as Trifolium
from jaxstage.references.trifolium import constant_feed_phase as constant_feed_phase
from jaxstage.references.trifolium import make_trifolium as make_trifolium
from jaxstage.references.trifolium import trifolium as trifolium
from jaxstage.references.trifolium import uniform_phase as uniform_phase
