"""Numerical parts without physics: integration, every kink, filters, geometry."""
