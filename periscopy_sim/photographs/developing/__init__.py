"""One picture of linear light from what a camera took: exposures, dark frame, flat field."""
