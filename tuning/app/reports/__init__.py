"""Self-contained HTML reports of what a command left in a folder."""
