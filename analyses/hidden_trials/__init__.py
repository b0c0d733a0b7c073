"""Trials of the detective on campaigns of the foreign camera: drawn, run one by one, judged, summed up."""
