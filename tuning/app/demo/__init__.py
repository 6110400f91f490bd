"""``jaxstage demo``: other commands one after the other, and one report of all that they leave.

stages     which commands, in what order, and how a stopped demo goes on
answers    what they found, as one object and one picture
cli        what is printed
"""
