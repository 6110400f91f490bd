"""Direct fuzzy CMAC sliding-mode tracking of a biaxial stage (Mao et al. 2021)."""

from jaxstage.studies.fuzzy_cmac.loops import study as study
