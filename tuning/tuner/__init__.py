"""The tuner: gains that are better on plants it never saw, found by gradients, with the evidence.

The search:
transforms, space      which gains, in which box, as an unconstrained vector
figures, objective     what matters: figures of a run, terms, goals, risk over the runs
groups, programs       training runs, and the compiled functions of them
problem                values, gradients and Gauss-Newton matrices of many candidates
gradient_check         whether gradients can be trusted
method                 what a method is: pure steps that ask an oracle
levenberg_marquardt, lbfgs, first_order, cma, random_search
prices, journal        units, and kept evaluations
ledger, tune           what was asked and what it cost; budget, progress

Around it:
options, training, sets, configuration     what the user asks for, as one table
session, worst_case, judging, diagnostics  rounds of training, then the tests of the result
baselines, fronts, pareto                  other methods, trade-offs
cli, display, report, pictures             what is printed and written
"""
