"""What a loop is made of: fields, signals, blocks, settings, validation."""
