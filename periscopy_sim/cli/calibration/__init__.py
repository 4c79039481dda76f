"""What calibrates a scene, or finds an occluder in it: `periscopy calibrate`."""
