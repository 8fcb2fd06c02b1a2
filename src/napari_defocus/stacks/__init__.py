"""Several planes through focus: focus stacking, depth from focus, focus curves."""
