"""The forward model (1): how a scene and its blur make a picture."""
