"""Commands that study methods and scenes: sweeps and their figures, data sets, designs."""
