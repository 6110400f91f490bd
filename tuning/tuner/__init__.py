"""Gradient-based tuning: gains that are better on plants it never saw, with the evidence.

problem/    what is optimised: search space, training runs, objective and its compiled derivatives
search/     how: Levenberg-Marquardt, L-BFGS, CMA-ES and others over a budgeted oracle, with a log
evidence/   why it is believed: validation, held-out verdict, worst plants, diagnostics

On top of these: `options` and `configuration` (what the user asks for, as one table), `session`
(rounds of training, then validation), `baselines` and `pareto` (other methods, trade-offs),
`report` and `pictures` (what is written).
"""
