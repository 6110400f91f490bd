"""What is uncertain: spreads, designs, scenario files, statistics."""
