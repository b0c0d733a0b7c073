"""The catalogue: every physical effect, discovered from this package and from installed extensions."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from importlib.metadata import entry_points
from types import MappingProxyType

from isetval.core.effect import STAGES, Effect
from isetval.core.errors import InputError

ENTRY_POINTS = "isetval.effects"
_plugged: dict[type[Effect], str] = {}


def plug_in(effects: Iterable[type[Effect]], origin: str) -> None:
    """Put further effects into the catalogue; ``origin`` says where they come from."""
    _plugged.update(dict.fromkeys(effects, origin))
    catalogue.cache_clear()


@lru_cache(maxsize=1)
def catalogue() -> Mapping[str, type[Effect]]:
    """Effect classes by their stable name, along the light path.

    Classes come from the modules of this package and from the entry points of the group
    ``isetval.effects`` of installed packages (each naming one class), and from `plug_in`.

    Raises
    ------
    InputError
        If an extension cannot be loaded, is no effect, or takes a name that is in use.
    """
    found: dict[str, type[Effect]] = {}
    for cls, origin in [*_own(), *_installed(), *_plugged.items()]:
        if cls.name in found and found[cls.name] is not cls:
            raise InputError(f"{origin}: the effect name {cls.name!r} is in use by {found[cls.name].__module__}; rename it")
        found[cls.name] = cls
    path = sorted(found.values(), key=lambda cls: (STAGES.index(cls.stage), cls.order, cls.name))
    return MappingProxyType({cls.name: cls for cls in path})


def _own() -> Iterator[tuple[type[Effect], str]]:
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for thing in vars(module).values():
            if isinstance(thing, type) and issubclass(thing, Effect) and thing.name and thing.__module__ == module.__name__:
                yield thing, module.__name__


def _installed() -> Iterator[tuple[type[Effect], str]]:
    for point in entry_points(group=ENTRY_POINTS):
        where = f"entry point {point.name} = {point.value}"
        try:
            thing = point.load()
        except Exception as error:
            raise InputError(f"{where}: cannot be loaded ({error}); mend or uninstall the package that declares it") from error
        if not (isinstance(thing, type) and issubclass(thing, Effect) and thing.name and thing.stage in STAGES):
            raise InputError(f"{where}: not an effect; it must name a class derived from isetval.Effect with name and stage")
        yield thing, where
