"""What else would explain a part of what is named is said beside the name."""

from isetval.app.cli.loop_words import diagnosis_lines


def candidate(name, dchi2, value):
    estimate = {"p": {"value": value, "sigma": 1.0}}
    return {"name": name, "dchi2": dchi2, "estimate": estimate, "p_corrected": 1.0, "posterior": 0.0, "observable": True}


def result(*candidates):
    effect = {
        "name": "pixel_angular_response", "posterior": 0.99, "equivalent": [], "forms": [],
        "parameters": {"m": {"value": 0.06, "sigma": 0.01, "unit": "1", "nominal": 0.0, "delta": 0.06}},
        "present_in_model": False,
    }  # fmt: skip
    rest = {"gate": {"run": False}, "leftover": None, "unobservable": [], "next_captures": [], "ladder": [], "notes": []}
    return {"verdict": "attributed", "effects": [effect], "candidates": list(candidates), **rest}


def told(found):
    return [line for line in diagnosis_lines(found) if line.startswith("  rivals")]


def test_the_film_is_a_rival_of_an_angular_loss():
    """The best form of each other effect counts once; what explains less than half is no rival."""
    (line,) = told(
        result(
            candidate("pixel_angular_response", 2400.0, 0.1),
            candidate("pixel_angular_response (form sin2)", 2399.0, 0.1),
            candidate("vignetting (power 1)", 1800.0, 0.2),
            candidate("vignetting", 1700.0, 0.2),
            candidate("ray_transfer", 2376.0, -210.0),
            candidate("dust", 1100.0, 1.0),
        )
    )
    assert line == (
        "  rivals of pixel_angular_response, by what each alone explains at first sight of what it does: "
        "ray_transfer 99 % (p -210.0 +- 1.0); vignetting (power 1) 75 % (p 0.2 +- 1.0)"
    )


def test_without_rivals_nothing_is_said():
    assert told(result(candidate("pixel_angular_response", 2400.0, 0.1), candidate("dust", 1.0, 1.0))) == []
