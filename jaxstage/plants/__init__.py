"""Machines, one file each."""

from jaxstage.plants.parts.friction import CreepingFriction as CreepingFriction
from jaxstage.plants.parts.friction import FrictionLaw as FrictionLaw
from jaxstage.plants.parts.lugre import Lugre as Lugre
from jaxstage.plants.parts.motor import Motor as Motor
from jaxstage.plants.parts.rigid import RigidState as RigidState
from jaxstage.plants.pmlsm_stage import PmlsmStage as PmlsmStage
from jaxstage.plants.pmlsm_stage import pmlsm_stage as pmlsm_stage
from jaxstage.plants.pmsm_table import PmsmTable as PmsmTable
from jaxstage.plants.pmsm_table import TableState as TableState
from jaxstage.plants.pmsm_table import friction_force as friction_force
from jaxstage.plants.pmsm_table import pmsm_table as pmsm_table
from jaxstage.plants.pmsm_table import stribeck as stribeck
from jaxstage.plants.screw_table import ScrewTable as ScrewTable
from jaxstage.plants.screw_table import screw_table as screw_table
from jaxstage.plants.two_inertia import FrictionSide as FrictionSide
from jaxstage.plants.two_inertia import Integration as Integration
from jaxstage.plants.two_inertia import TwoInertia as TwoInertia
from jaxstage.plants.two_inertia import TwoInertiaState as TwoInertiaState
from jaxstage.plants.two_inertia import explicit as explicit
from jaxstage.plants.two_inertia import implicit as implicit
from jaxstage.plants.two_inertia import on_load as on_load
from jaxstage.plants.two_inertia import on_motor as on_motor
from jaxstage.plants.two_inertia import two_inertia as two_inertia
