"""Folders and result files that commands leave and take back."""
