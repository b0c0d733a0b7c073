"""A real laboratory's pictures from folder to verdict: `python -m analyses.flea3 --data FOLDER`.

Pictures: bllanos/chromatic-aberration (Bernard Llanos, University of Alberta; Boost Software License 1.0), read from ``--data``
and not kept here.
"""
