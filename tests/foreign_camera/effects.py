"""Hidden effects, each written from its physics; none of them knows how ``isetval`` describes it.

A stage is a place in the camera; a function gets the stage's quantity, the camera, the place (shot) and a
random stream or context, and its own parameters by name.
"""

from __future__ import annotations

from dataclasses import replace

STAGES = {}
CONSTANTS = {}


def at(stage, name):
    """Register a function as what effect ``name`` does at ``stage``."""

    def register(function):
        STAGES.setdefault(stage, {})[name] = function
        return function

    return register


def apply_stage(stage, value, camera, place, more):
    """The quantity behind all hidden effects of a stage."""
    for name, function in STAGES.get(stage, {}).items():
        if name in camera.hidden:
            value = function(value, camera, place, more, **camera.hidden[name])
    return value


def with_constants(camera):
    """The camera with the hidden effects that are only another constant of it."""
    for name, parameters in camera.hidden.items():
        if name in CONSTANTS:
            fields = CONSTANTS[name]
            camera = replace(camera, **{fields[key]: value for key, value in parameters.items()})
    return camera
