"""Plots: the only home of matplotlib."""
