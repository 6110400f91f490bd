"""Optimisers over one budgeted oracle."""
