"""The paper's results with the same code on both sides: `python -m analyses.paper`; one script per result.

Lyu, Goossens, Wandell and Farrell, "Accurate smartphone camera simulation using 3D scenes" (2022).  Its data belong to its
authors: they are read from ``--data`` and none of them is kept here.
"""
