"""Analyses of single shots: each module of this folder states ``ROLES`` and ``analyze(shot, captures, choices)``.

`isetval.measure.campaign` scans the folder; a new analysis is one new file.  ``analyze`` returns a
`Block` of metrics with their joint covariance; what it chose from the data it puts into
``Block.choices`` and takes from ``choices`` when they are given.  ``GIVES`` names the metrics that it can also measure at
conditions given by a table: ``choices["wanted"]`` are such rows, ``choices["method"]`` the stated procedure.
"""
