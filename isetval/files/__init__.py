"""Files in and out: DNG, campaign folders, targets, loose files; what comes in is data, never a path to trust."""
