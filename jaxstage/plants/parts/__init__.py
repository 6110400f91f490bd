"""Parts that several machines share."""
