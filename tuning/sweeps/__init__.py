"""Monte-Carlo robustness sweeps: `configuration` is what a sweep depends on, `sweep` simulates it
chunk by chunk, `store` keeps it, `analysis` says what it means."""
