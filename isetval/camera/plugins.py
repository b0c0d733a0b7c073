"""Effects in a file beside a camera model: ``plugin = "my_effects.py"``, run only where a person allowed it."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from isetval.core.cache import add_code
from isetval.core.effect import STAGES, Effect
from isetval.core.errors import InputError
from isetval.core.toml import named_file
from isetval.effects import plug_in

_allowed: ContextVar[bool] = ContextVar("plugins_allowed", default=False)


@contextmanager
def plugins_allowed(allow: bool = True) -> Iterator[None]:
    """Inside, model files may run the programs that they name as ``plugin``."""
    token = _allowed.set(allow)
    try:
        yield
    finally:
        _allowed.reset(token)


def load_plugin(name: str, model_file: Path) -> tuple[str, ...]:
    """Import the plugin that a model file names, and put its effects into the catalogue; returns their names.

    The module is imported under its own name, and its folder is put at the end of the search path, so that worker
    processes find it as well.

    Raises
    ------
    InputError
        Where nobody allowed it, the file does not exist, cannot be run, holds no effect, or bears the name of another module.
    """
    path = named_file(name, model_file.parent)
    if not _allowed.get():
        raise InputError(
            f"{model_file}: plugin = {name!r} is a program; read it, then allow it with --allow-plugin "
            "(in Python: with isetval.camera.plugins.plugins_allowed())"
        )
    if not path.is_file() or path.suffix != ".py" or not path.stem.isidentifier():
        raise InputError(f'{model_file}: plugin names {path}, which is no Python file; write plugin = "my_effects.py"')
    effects = _effects_of(path)
    add_code(path)
    plug_in(effects, str(path))
    return tuple(cls.name for cls in effects)


def _effects_of(path: Path) -> list[type[Effect]]:
    """Effect classes that a file defines."""
    found = importlib.util.find_spec(path.stem)
    if found is not None and (found.origin is None or Path(found.origin).resolve() != path.resolve()):
        raise InputError(f"{path}: another module is called {path.stem}; rename the file")
    if found is None:
        sys.path.append(str(path.resolve().parent))
        importlib.invalidate_caches()
    try:
        module = importlib.import_module(path.stem)
    except Exception as error:
        raise InputError(f"{path}: cannot be run ({type(error).__name__}: {error}); mend it") from error
    effects = [
        thing
        for thing in vars(module).values()
        if isinstance(thing, type) and issubclass(thing, Effect) and thing.name and thing.__module__ == module.__name__
    ]
    if not effects or any(cls.stage not in STAGES for cls in effects):
        raise InputError(f"{path}: holds no effect; it must define a class derived from isetval.Effect with name and stage")
    return effects
