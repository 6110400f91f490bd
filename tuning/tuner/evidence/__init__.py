"""What a tuning result rests on: validation, diagnostics, worst cases."""
