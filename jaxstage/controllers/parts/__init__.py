"""Parts that several laws share."""
