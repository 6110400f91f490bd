"""What is tuned and on what: search space, scenario sets, objective."""
