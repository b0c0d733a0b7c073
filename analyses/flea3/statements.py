"""What the numbers say in sentences, each with how sure it is and what would test it; every number is read from the result."""

from __future__ import annotations

from statistics import median
from typing import Any

from analyses.flea3.verdict import NAMED

FAR_NM = 60.0  # six widths of the filters


def statements(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    """(statement, how sure, what would test it)."""
    return [*_response(result), *_dark(result), *_color(result), *_glare(result), *_lens(result), *_named(result)]


def _response(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    lines = result["linearity"]
    offsets = ", ".join(f"{x['offset_dn'][0]:.2f} +- {x['offset_dn'][1]:.2f} DN ({name})" for name, x in lines.items())
    gains = ", ".join(f"{x['chi2']['+ drift of the light'] - x['chi2']['+ offset']:.0f}" for x in lines.values())
    bends = ", ".join(f"{100 * x['bend'][0]:.1f} +- {100 * x['bend'][1]:.1f} %" for x in lines.values())
    times = ", ".join(f"{x['exposure_offset_ms'][0]:.2f} +- {x['exposure_offset_ms'][1]:.2f} ms" for x in lines.values())
    drift = ", ".join(f"{x['drift_rms_percent']:.1f} %" for x in lines.values())
    return [
        (
            f"Codes lie below the light by {offsets}: they look cut off to whole codes, not rounded as the README says (-.5 DN).",
            f"chi2 falls by {gains}; two visits with other targets agree; a true offset of the camera would look the same.",
            "The original 12-bit files, or a dark with a pedestal.",
        ),
        (
            f"The response bends down: at 255 DN a straight line would lie {bends} higher.",
            "Fits of both visits agree in sign; the light's drift between exposures is fitted beside it, 3 % prior.",
            "A steady light at two levels and one exposure time.",
        ),
        (f"No exposure offset: {times}.", "zero within its sigma on both visits.", "Exposures below 1 ms."),
        (
            f"The projector changes by {drift} rms from picture to picture.",
            "one factor for all patches and colours of a picture; what remains after offset and bend.",
            "A monitor diode, or a patch that every picture shows.",
        ),
    ]


def _dark(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    out = []
    for name, d in result["darks"].items():
        last = d["frames"][-1]
        seen, line = list(d["growth_dn"].values()), list(d["growth_of_a_line_dn"].values())
        linear = abs(seen[-2] / max(line[-2], 1e-9) - 1) < 0.25
        out.append(
            (
                f"{name}: {last['hot']} of {d['pixels']} pixels show 8 DN or more after {last['time_s']:g} "
                f"s, {last['hot_in_both_frames']} of "
                f"them in both frames; they {'grow in proportion to time' if linear else 'do not grow in proportion to time'} "
                f"({seen[-2]:.1f} DN at .5 s where a line through {last['time_s']:g} s says {line[-2]:.1f}).",
                "counted; dark current of ordinary pixels stays below the codes.",
                "Darks with an offset; on the shrunk pictures of the second visit a hot pixel is one of 36.",
            )
        )
    return out


def _color(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    weak = [r for r in result["spectral"] if r["relative"] < 0.5]
    words = ", ".join(f"{r['channel']} at {r['light']} {100 * r['relative']:.1f} %" for r in weak)
    far = [r for r in result["spectral"] if r["effective_nm"] and abs(r["effective_nm"] - r["nm"]) > FAR_NM]
    missed = [(abs(r["effective_nm"] - r["nm"]) > FAR_NM, r["misfit_percent"]) for r in result["spectral"] if r["effective_nm"]]
    rough, fine = (median([m for is_far, m in missed if is_far == k] or [0.0]) for k in (True, False))
    leaks = ", ".join(f"{r['channel']} at {r['light']} sees {r['effective_nm']:.0f} nm on average" for r in far) or "none"
    return [
        (
            f"By the pattern of the 24 patches these channels see light far from their band: {leaks}.",
            f"more than {FAR_NM:g} nm off; the patches' misfit is {rough:.0f} % there and {fine:.0f} % elsewhere (medians), so "
            "the mixture is rough; disks of the same band lie apart in these colours (below), which says the same independently.",
            "A second filter of the same band in the beam.",
        ),
        (
            f"Weak channels against the strongest of the band: {words}.",
            "white patch, offset and bend removed, 1 to 3 % by drift; below 3 DN by the offset's own "
            "error. The absolute level of a band is not known.",
            "The projector's spectrum in absolute units, a monochromator.",
        ),
    ]


def _glare(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    found = result["glare"]
    words = ", ".join(f"{g['light']} {g['percent']:+.2f} +- {g['sigma']:.2f} %" for g in found)
    clear = [g["light"] for g in found if g["percent"] > 3 * g["sigma"]]
    said = f"seen by more than three sigma at {', '.join(clear)}" if clear else "at no band by three sigma"
    return [
        (
            f"Glare into dark patches, percent of the white patch: {words}; {said}.",
            "intercept of the six greys against their reflectances, each known to 5 %; a black patch that reflects a tenth more "
            "than its table would look the same.",
            "A hole in black velvet in place of the black patch.",
        )
    ]


def _lens(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    lens = result["lens"]
    grown = [b for b in lens["bands"] if "growth" in b]
    words = ", ".join(f"{b['light']} {1e3 * b['growth']:+.2f} +- {1e3 * b['growth_sigma']:.2f}" for b in grown)
    sharp = ", ".join(f"{b['light']} {b['mtf50_cy_px']:.3f} +- {b['mtf50_sigma']:.3f}" for b in lens["bands"])
    apart = [w for w in lens["within"] if abs(w["radial_px"]) > 5 * w["radial_sigma_px"]]
    inside = ", ".join(f"{w['channels']} at {w['light']} {w['radial_px']:+.2f} +- {w['radial_sigma_px']:.2f} px" for w in apart)
    return [
        (
            f"Lateral colour, growth of the picture against {lens['reference']} in 1/1000: {words}.",
            "sigma widened by the scatter of the disks; chi2 per degree of freedom stands in the table, "
            "and where it is large the sheet moved or turned.",
            "All filters in one mount without touching camera and sheet; disks over the whole field.",
        ),
        (
            f"Axial colour, MTF50 in cycles per pixel: {sharp}.",
            "statistical sigma; one field place and one focus, so that it may be focus alone.",
            "A focus series at each band.",
        ),
        (
            f"Inside one band colours lie apart: {inside or 'none by more than five sigma'}; what charge "
            f"crosstalk brings would lie on top of "
            "its source, so that this light comes from another part of the spectrum.",
            "five sigma and more, several exposures; faint channels of a few DN are bent by the cut codes.",
            "The filters' transmission far from their bands with a bright lamp.",
        ),
    ]


def _named(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    verdict = result.get("verdict")
    if not verdict:
        return []
    out = []
    for where, by in verdict["frozen"].items():
        words = ", ".join(f"{name} {x['rms_percent']:.2f} % (median z {x['median_z']:.2f})" for name, x in by.items())
        out.append(
            (
                f"Left out, {where}: rms error of the levels over exposure times with the response found elsewhere: {words}.",
                "offset and bend frozen, fitted without these rows; rates and one light factor a picture are refitted.",
                "Another visit with the original 12 bits.",
            )
        )
    compared = "; ".join(
        f"{where}: "
        + ", ".join(f"{r['model']} {100 * r['rms_relative_error']:.1f} % (z^2 {r['mean_square_z']:.0f})" for r in rows)
        for where, rows in verdict["left_out"].items()
    )
    out.append(
        (
            f"isetval compare, the whole model with laboratory priors: {compared}.",
            f"{_settled(verdict['left_out'])} Reflectances are free to 5 % in each band; the filters' leak into weak colours is "
            "that of their table times a lamp that nobody measured.",
            "Repeated frames, a measured light field and the projector's spectrum.",
        )
    )
    found = verdict.get("diagnosis")
    if found:
        names = "; ".join(map(_in_words, found["effects"])) or "nothing"
        left = f" Left over: {found['leftover']}." if found["leftover"] else ""
        out.append(
            (
                f"isetval diagnose: {found['verdict']}, {names}.{left}",
                f"by the catalogue alone. {_judged(verdict['left_out'])}",
                "Charts at true pixels with repeats.",
            )
        )
    return out


def _in_words(effect: dict[str, Any]) -> str:
    """An effect with its values and what these captures do not tell it from."""
    values = ", ".join(f"{name} {p['value']:.3g} +- {p['sigma']:.2g} {p['unit']}" for name, p in effect["parameters"].items())
    rivals = f"; not to be told from {', '.join(effect['equivalent'])}" if effect["equivalent"] else ""
    return f"{effect['name']} ({values}; posterior {effect['posterior']:.2f}{rivals})"


def _judged(left_out: dict[str, Any]) -> str:
    """Whether what was named lowers the error on captures that were not used."""
    rows = [row for own in left_out.values() for row in own if any(other["model"] == NAMED for other in own)]
    if not rows:
        return "nothing was added, so that no error could fall."
    before, after = (next(row for row in rows if (row["model"] == NAMED) == is_named) for is_named in (False, True))
    numbers = f"{before['mean_square_z']:.2f} to {after['mean_square_z']:.2f} (their rms error from " + (
        f"{100 * before['rms_relative_error']:.2f} to {100 * after['rms_relative_error']:.2f} %)"
    )
    fell = after["mean_square_z"] < before["mean_square_z"]
    return f"On captures left out its mean-square z {'falls from' if fell else 'does not fall:'} {numbers}."


def _settled(left_out: dict[str, Any]) -> str:
    """Whether the fits behind a comparison stand for anything."""
    open_fits = [f"{row['model']} ({where})" for where, rows in left_out.items() for row in rows if not row.get("settled", False)]
    if not open_fits:
        return "the fits of the laboratory's unknowns settled in every rung."
    return f"no verdict where the fits of the laboratory's unknowns did not settle: {', '.join(open_fits)}."
