"""Where hidden effects act; each is written from its physics, and none knows how ``isetval`` describes it.

A stage is a place in the camera; a function gets the stage's quantity, the camera, the place (shot), what else
nature knows there (a random stream, the light), and its own parameters by name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from .types import Camera, Place

STAGES: dict[str, dict[str, Callable[..., Any]]] = {}
CONSTANTS: dict[str, dict[str, str]] = {}


def at(stage: str, name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register a function as what effect ``name`` does at ``stage``."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        STAGES.setdefault(stage, {})[name] = function
        return function

    return register


def known() -> set[str]:
    """All effects that can be hidden."""
    return set(CONSTANTS).union(*STAGES.values())


def apply_stage(stage: str, value: Any, camera: Camera, place: Place, more: Any) -> Any:
    """The quantity behind all hidden effects of a stage."""
    for name, function in STAGES.get(stage, {}).items():
        if name in camera.hidden:
            value = function(value, camera, place, more, **camera.hidden[name])
    return value


def with_constants(camera: Camera) -> Camera:
    """The camera with the hidden effects that are only another constant of it."""
    for name, parameters in camera.hidden.items():
        if name in CONSTANTS:
            fields = CONSTANTS[name]
            changed: dict[str, Any] = {fields[key]: value for key, value in parameters.items()}
            camera = replace(camera, **changed)
    return camera
