"""What a sensor sees of a rendered scene through a lens file, ray by ray or blurred in image space."""
