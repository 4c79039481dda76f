"""Commands that bring a laboratory into the package: its scene, its photographs."""
