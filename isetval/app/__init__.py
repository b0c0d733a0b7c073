"""What people start: the command line, reports, plots, the demo, challenges."""
