"""What the chair could have been: occluders of equal area, ranked by the bound and in pictures."""
