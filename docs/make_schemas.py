"""JSON schemas of the two file formats for editors, made from the code: python docs/make_schemas.py."""

import dataclasses
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from isetval.core.campaign import SCOPES, SHOT_NUISANCES  # noqa: E402
from isetval.core.sensor import CFA_PATTERNS  # noqa: E402
from isetval.effects import catalogue  # noqa: E402
from isetval.files import campaign_file, campaign_shots, sidecar, target_file  # noqa: E402

DRAFT = "http://json-schema.org/draft-07/schema#"
NUMBER, TEXT, ARRAY, TEXTS = (
    {"type": "number"},
    {"type": "string"},
    {"type": "array"},
    {"type": "array", "items": {"type": "string"}},
)
NUMBERS = {"type": "array", "items": NUMBER}
ROLES = {"enum": ["dark", "flat", "edge", "chart", "scene"]}
KINDS = {  # of keys whose kind no declaration states; all others may hold anything
    "role": ROLES, "measurement_session": TEXT, "setup": TEXT, "light": TEXT, "light_level": NUMBER, "exposure_s": NUMBER, "iso": NUMBER,
    "rotation_deg": NUMBER, "window": NUMBERS, "frames": {"type": "integer", "minimum": 1}, "files": TEXTS, "target": TEXT,
    "focus_um": NUMBER, "distance_m": NUMBER, "repeat_of": TEXT, "name": TEXT, "metrics": TEXT, "method": TEXT, "channel": TEXT,
    "angle_deg": NUMBER, "orientation": {"enum": ["vertical", "horizontal"]}, "offset_px": NUMBERS, "dark_side": {"enum": ["low", "high"]},
    "roi": NUMBERS, "margin_px": NUMBER, "patch": ARRAY, "line": ARRAY, "file": TEXT, "kind": {"enum": ["edge", "chart", "scene"]},
    "roles": {"type": "array", "items": ROLES}, "lights": TEXTS, "setups": TEXTS, "scope": {"enum": list(SCOPES)},
    "parameter": {"anyOf": [{"enum": sorted(SHOT_NUISANCES)}, {"type": "string", "pattern": "^[a-z0-9_]+\\.[a-z0-9_]+$"}]},
}  # fmt: skip


def table(keys, needed=(), **kinds):
    """A table with these keys and no others."""
    properties = {key: kinds.get(key, KINDS.get(key, {})) for key in keys}
    return {"type": "object", "properties": properties, "required": list(needed), "additionalProperties": False}


def sensor():
    """[sensor]."""
    keys = {
        "rows": {"type": "integer"},
        "cols": {"type": "integer"},
        "pixel_um": NUMBER,
        "white_dn": NUMBER,
        "bits": {"type": "integer"},
    }
    keys |= {
        "cfa": {"enum": ["RGGB", "BGGR", "GRBG", "GBRG", "MONO"]},
        "black_dn": {"anyOf": [NUMBER, {"type": "array", "items": NUMBERS}]},
    }
    return table(keys, ("rows", "cols", "pixel_um", "cfa", "black_dn", "white_dn"), **keys)


def effect(cls):
    """[[effect]] of one name."""
    keys = {"name": {"const": cls.name, "description": (cls.__doc__ or "").strip().split("\n")[0]}}
    for p in cls.parameters():
        bounds = {k: v for k, v in (("minimum", p.low), ("maximum", p.high)) if abs(v) < float("inf")}
        keys[p.name] = {"type": "number", "description": f"{p.doc} [{p.unit}]", "default": p.null} | bounds
    for item in dataclasses.fields(cls):
        if item.name not in keys and item.name not in ("base", "name"):
            keys[item.name] = TEXTS if item.name == "fitted_to" else {}
    keys["source"] = TEXT
    keys |= {key: {} for key in ("sigma", "sigma_of", "provenance") if key not in keys}
    return table(keys, ("name",), **keys)


def camera():
    """camera.toml."""
    effects = [effect(cls) for cls in catalogue().values()]
    keys = {
        "name": TEXT,
        "notes": {},
        "plugin": TEXT,
        "sensor": sensor(),
        "effect": {"type": "array", "items": {"anyOf": effects}},
    }
    return {"$schema": DRAFT, "title": "isetval camera model"} | table(keys, ("sensor", "effect"), **keys)


def campaign():
    """campaign.toml."""
    targets = [
        table(getattr(target_file, f"_{kind.upper()}_KEYS"), ("kind",), kind={"const": kind})
        for kind in ("edge", "chart", "scene")
    ]
    parts = {
        "name": TEXT, "camera": TEXT, "notes": {}, "sensor": sensor(),
        "light": {"type": "object"}, "target": {"type": "object", "additionalProperties": {"anyOf": targets}},
        "nuisance": {"type": "array", "items": table(campaign_file._NUISANCE_KEYS, ("parameter", "sigma", "scope"), sigma=NUMBER)},
        "shot": {"type": "array", "items": table(campaign_shots.SHOT_KEYS, ("role",))},
    }  # fmt: skip
    return {"$schema": DRAFT, "title": "isetval campaign"} | table(campaign_file._KEYS, ("shot",), **parts)


def picture():
    """images.toml, the sidecar of pictures."""
    cells = {"anyOf": [NUMBER, {"type": "array", "items": NUMBER, "minItems": 4, "maxItems": 4}]}
    pair = {"type": "array", "items": {"type": "integer", "minimum": 0}, "minItems": 2, "maxItems": 2}
    kinds = dict.fromkeys(sidecar.NUMBERS, NUMBER) | dict.fromkeys(sidecar.TEXTS, TEXT)
    kinds |= {"black_dn": cells, "window": pair, "sensor": pair, "levels_only": {"type": "boolean"}}
    kinds |= {
        "cfa": {"enum": list(CFA_PATTERNS)},
        "channel": {"enum": ["R", "G", "B"]},
        "encoding": {"enum": list(sidecar.ENCODINGS)},
    }
    some = table((*sidecar.KEYS, "match"), ("match",), match=TEXT, **kinds)
    whole = table((*sidecar.KEYS, "image"), image={"type": "array", "items": some}, **kinds)
    return {"$schema": DRAFT, "title": "isetval sidecar of pictures"} | whole


def schemas():
    """File name -> schema."""
    return {"camera.schema.json": camera(), "campaign.schema.json": campaign(), "images.schema.json": picture()}


def write_schemas():
    """Write them into ``docs/schema``; the paths."""
    (HERE / "schema").mkdir(exist_ok=True)
    paths = []
    for name, schema in schemas().items():
        paths.append(HERE / "schema" / name)
        paths[-1].write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")
    return paths


if __name__ == "__main__":
    print(*write_schemas(), sep="\n")
