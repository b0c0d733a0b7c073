"""A second, independent little camera: numpy and the standard library only, nothing from ``isetval``.

It writes campaign folders (``campaign.toml``, ``camera.toml``, spectra, DNG files) as another laboratory
would, with or without a hidden effect, and is the source of truth of the hidden-effect tests.
"""
