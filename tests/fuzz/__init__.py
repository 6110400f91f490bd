"""Random uses: what the command line and the library make of clumsy and hostile input."""
