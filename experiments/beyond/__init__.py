"""What goes beyond the paper: the noise-aware method, its ablation, video, calibration."""
