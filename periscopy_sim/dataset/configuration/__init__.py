"""What a data set shall hold: its YAML file, distributions and sources."""
