"""Exported laws on an emulated Cortex-M4F."""
