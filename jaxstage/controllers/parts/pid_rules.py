"""The classical 49 rules that tune the gains of a PID law from an error and its rate.

Written for the error "actual minus reference": with a magnitude E >= 0 of the error the inputs are
-E and -E', so that a large error meets the rows NB. Fed with +E they lower K_P when the error is
large. Rows: error; columns: its rate; both from NB to PB.

Source: the self-tuning fuzzy-PID table that circulates in the literature, in both conventions of
sign. The rule table of Science Progress 2021, doi:10.1177/00368504211011847, which these rules
stand in for, is lost.
"""

PROPORTIONAL = """
    PB PB PM PM PS ZO ZO
    PB PB PM PS PS ZO NS
    PM PM PM PS ZO NS NS
    PM PM PS ZO NS NM NM
    PS PS ZO NS NS NM NM
    PS ZO NS NM NM NM NB
    ZO ZO NM NM NM NB NB
"""

INTEGRAL = """
    NB NB NM NM NS ZO ZO
    NB NB NM NS NS ZO ZO
    NB NM NS NS ZO PS PS
    NM NM NS ZO PS PM PM
    NM NS ZO PS PS PM PB
    ZO ZO PS PS PM PB PB
    ZO ZO PS PM PM PB PB
"""

DERIVATIVE = """
    PS NS NB NB NB NM PS
    PS NS NB NM NM NS ZO
    ZO NS NM NM NS NS ZO
    ZO NS NS NS NS NS ZO
    ZO ZO ZO ZO ZO ZO ZO
    PB NS PS PS PS PS PB
    PB PM PM PM PS PS PB
"""
