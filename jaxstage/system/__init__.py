"""The machine that the program runs on: files, cores, cache, precision."""
