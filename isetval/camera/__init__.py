"""Camera models: a sensor and its effects in order, their file, and shooting a plan with them."""
