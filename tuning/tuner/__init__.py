"""The tuner: gains that are better on plants it never saw, found by gradients, with the evidence.

transforms, space      which gains, in which box, as an unconstrained vector
figures, objective     what matters: figures of a run, terms, goals, risk over the runs
problem                training runs and objective, compiled: values, gradients, Gauss-Newton
levenberg_marquardt, lbfgs, first_order, cma, random_search     the methods, as pure steps
journal, tune          units, budget, progress, kept evaluations
"""
