"""Commands that bring a laboratory into the package: its photographs."""
