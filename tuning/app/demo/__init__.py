"""What ``jaxstage demo`` runs, and what it says of it.

stages     which commands, in what order, and how a stopped demo goes on
answers    their results, as one object and one picture
"""
