"""One control period, rollouts, batches, gradients and stability of a loop."""
