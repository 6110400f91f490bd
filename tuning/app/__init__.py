"""The command line: every command, its display and its reports."""
