"""Drives, sensors and loads around a plant."""
