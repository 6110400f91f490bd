"""Machines, one file each."""

from jaxstage.plants.pmsm_table import PmsmTable as PmsmTable
from jaxstage.plants.pmsm_table import TableState as TableState
from jaxstage.plants.pmsm_table import friction_force as friction_force
from jaxstage.plants.pmsm_table import pmsm_table as pmsm_table
