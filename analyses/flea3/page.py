"""The page `reports/flea3.html`: figures and tables of what was measured, each statement with how sure it is."""

from __future__ import annotations

import base64
import io
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem; color: #1a1a1a; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .92rem; display: block; overflow-x: auto; }
th, td { border-bottom: 1px solid #ccc; padding: .25rem .7rem; text-align: right; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; height: auto; } .sure { color: #444; } h2 { margin-top: 2.2rem; }
@media (max-width: 640px) { .said th { display: none; }
.said td { display: block; border: 0; }
.said td:last-child { border-bottom: 1px solid #ccc; } }
"""


def write_page(path: Path, result: dict[str, Any]) -> None:
    """The whole page in one file."""
    parts = [
        "<h1>A machine-vision camera, from a laboratory's folder to a verdict</h1>",
        "<p>Measured: 95 pictures of 8 bits by B. Llanos (bllanos/chromatic-aberration, Boost Software "
        "License 1.0), a Point Grey Flea3 "
        "FL3-GE-50S5C behind a Computar 8 mm lens at f/4, a projector behind band-pass filters. First "
        "visit: printed disks, true crops "
        "of the mosaic. Second visit: a chart of 24, shrunk to a sixth. Nothing of the pictures is kept here; "
        "<code>python -m analyses.flea3 --data FOLDER</code> makes this page from them.</p>",
        *_statements(result),
        *_linearity(result),
        *_darks(result),
        *_spectral(result),
        *_lens(result),
        *_verdict(result),
    ]
    view = "<meta name=viewport content='width=device-width, initial-scale=1'>"
    head = f"<!doctype html><html lang=en><meta charset=utf-8>{view}" \
           f"<title>flea3</title><style>{STYLE}</style>"  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(head + "\n".join(parts) + "</html>\n")


def table(head: list[str], rows: list[list[object]]) -> str:
    """An HTML table; numbers to four digits."""

    def cell(value: object) -> str:
        if value is None or (isinstance(value, float) and not np.isfinite(value)):
            return "&ndash;"
        return escape(f"{value:.4g}" if isinstance(value, float) else str(value))

    body = "".join("<tr>" + "".join(f"<td>{cell(v)}</td>" for v in row) + "</tr>" for row in rows)
    return "<table><tr>" + "".join(f"<th>{escape(h)}</th>" for h in head) + "</tr>" + body + "</table>"


def image(draw: Any, words: str, size: tuple[float, float] = (8, 3.6)) -> str:
    """A matplotlib picture inside the page."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=size, layout="constrained")
    draw(figure)
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    plt.close(figure)
    return f"<img alt='{escape(words)}' src='data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}'>"


def _statements(result: dict[str, Any]) -> list[str]:
    left = "<td style='text-align:left'>"
    rows = "".join(
        f"<tr><td>{escape(a)}</td>{left}{escape(b)}</td>{left}{escape(c)}</td></tr>" for a, b, c in result["statements"]
    )
    return ["<h2>What can be said</h2>", "<table class=said><tr><th>statement</th><th style='text-align:left'>how sure</th>"
            f"<th style='text-align:left'>what would test it</th></tr>{rows}</table>"]  # fmt: skip


def _linearity(result: dict[str, Any]) -> list[str]:
    out = ["<h2>Linearity over exposure time, 25 ms to 3.916 s</h2>"]
    rows = []
    for name, line in result["linearity"].items():
        for step, chi2 in line["chi2"].items():
            rows.append([name, step, line["rows"], chi2])
    out.append(table(["captures", "response", "rows", "chi2"], rows))
    out.append(
        table(
            [
                "captures",
                "offset / DN",
                "sigma",
                "bend at 255 DN",
                "sigma",
                "exposure offset / ms",
                "sigma",
                "light, rms % by picture",
            ],
            [
                [n, *x["offset_dn"], *x["bend"], *x["exposure_offset_ms"], x["drift_rms_percent"]]
                for n, x in result["linearity"].items()
            ],
        )
    )

    def draw(figure: Any) -> None:
        for k, (name, line) in enumerate(result["linearity"].items()):
            axes = figure.add_subplot(1, 2, k + 1)
            for light in dict.fromkeys(d["light"] for d in line["drift_percent"]):
                own = [d for d in line["drift_percent"] if d["light"] == light]
                axes.errorbar(
                    [d["time_s"] for d in own],
                    [d["percent"] for d in own],
                    [d["sigma"] for d in own],
                    fmt="o-",
                    ms=3,
                    lw=1,
                    label=light,
                )
            axes.set(xscale="log", xlabel="exposure time / s", ylabel="light of the picture / %", title=f"measured: {name}")
            axes.legend(fontsize=7)

    return [*out, image(draw, "light by picture")]


def _darks(result: dict[str, Any]) -> list[str]:
    head = ["visit", "time / s", "mean / DN", "sigma", "pixels above 0", "8 DN and more", "in both frames", "largest / DN"]
    rows = [
        [name, f["time_s"], f["mean_dn"], f["sigma_dn"], f["above_zero"], f["hot"], f["hot_in_both_frames"], f["largest_dn"]]
        for name, d in result["darks"].items()
        for f in d["frames"]
    ]
    growth = [[name, *d["growth_dn"].values()] for name, d in result["darks"].items()]
    times = list(next(iter(result["darks"].values()))["growth_dn"])
    return ["<h2>Dark frames of two visits</h2>", table(head, rows), "<p>Mean of the hottest pixels in DN by exposure time:</p>",
            table(["visit", *(f"{t} s" for t in times)], growth)]  # fmt: skip


def _spectral(result: dict[str, Any]) -> list[str]:
    head = [
        "band",
        "channel",
        "DN/s on white",
        "of the strongest",
        "model says",
        "patches see / nm",
        "misfit %",
        "glare % of white",
    ]
    rows = [
        [
            r["light"],
            r["channel"],
            r["rate_dn_per_s"],
            r["relative"],
            r["model_relative"],
            r["effective_nm"],
            r["misfit_percent"],
            r["glare_percent"],
        ]
        for r in result["spectral"]
    ]
    return [
        "<h2>Relative spectral sensitivity at the bands, and where a weak channel's light comes from</h2>",
        "<p>The maker's data sheet of the sensor was not at hand: <em>model says</em> is "
        "data/flea3/qe.csv, own smooth curves with the "
        "peaks of this family of sensors. <em>Patches see</em> is the mean wavelength of the mixture of "
        "eight pieces of the spectrum whose "
        "reflectances explain the pattern of the 24 patches: a leak from elsewhere in the spectrum shows another pattern.</p>",
        table(head, rows),
    ]


def _lens(result: dict[str, Any]) -> list[str]:
    lens = result["lens"]
    rows = [
        [b["light"], b["channel"], b["exposure_s"], b["disks"], b["mtf50_cy_px"], b["mtf50_sigma"], b.get("growth", 0.0) * 1e3,
         b.get("growth_sigma", 0.0) * 1e3, b.get("radial_px", 0.0), b.get("radial_sigma_px", 0.0), b.get("chi2_over_dof")]
        for b in lens["bands"]
    ]  # fmt: skip
    within = [
        [w["light"], w["channels"], w["disks"], *w["mean_px"], w["radial_px"], w["radial_sigma_px"], w["mtf50_cy_px"]]
        for w in lens["within"]
    ]

    def draw(figure: Any) -> None:
        left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
        nm = [b["nm"] for b in lens["bands"]]
        left.errorbar(
            nm,
            [b.get("radial_px", 0.0) for b in lens["bands"]],
            [b.get("radial_sigma_px", 0.0) for b in lens["bands"]],
            fmt="ko-",
        )
        left.set(
            xlabel="nominal wavelength / nm", ylabel=f"growth against {lens['reference']} / px", title="measured: lateral colour"
        )
        for b in lens["bands"]:
            right.errorbar(b["frequency_cy_px"], b["mtf"], b["mtf_sigma"], lw=1.2, label=b["light"])
        right.set(
            xlabel="frequency / cycles per pixel",
            ylabel="SFR",
            ylim=(0, 1.05),
            title="measured: disks' edges",
        )
        right.legend(fontsize=7)

    head = ["band", "channel", "time / s", "disks", "MTF50 / cy/px", "sigma", "growth / 1e-3", "sigma", "px", "sigma", "chi2/dof"]
    return [
        "<h2>Lateral and axial colour against wavelength</h2>",
        image(draw, "lateral colour and SFR"),
        table(head, rows),
        "<p>Between two bands the sheet or the camera may have moved as a whole; growth does not care. "
        "Inside one band nothing moves: "
        "colours that lie apart see different parts of the spectrum.</p>",
        table(["band", "channels", "disks", "row / px", "column / px", "outwards / px", "sigma", "its MTF50"], within),
    ]  # fmt: skip


def _verdict(result: dict[str, Any]) -> list[str]:
    verdict = result.get("verdict")
    if not verdict:
        return ["<h2>Verdict</h2><p>Not run (--quick).</p>"]
    frozen = [
        [where, name, x["rows"], x["rms_percent"], x["median_z"]]
        for where, by in verdict["frozen"].items()
        for name, x in by.items()
    ]
    ladder = [
        [where, r["model"], r["n"], r["mean_square_z"], 100 * r["rms_relative_error"]]
        for where, rows in verdict["left_out"].items()
        for r in rows
    ]
    found = verdict.get("diagnosis")
    named = (
        f"<p>isetval diagnose: {escape(found['verdict'])}.</p>"
        if found
        else "<p>isetval diagnose: no verdict, not run to an end.</p>"
    )
    return [
        "<h2>On captures left out</h2>",
        f"<p>Response fitted on the charts without 650 nm, .25 s and 2 s: offset {verdict['offset_dn'][0]:.3f} DN, bend "
        f"{verdict['bend'][0]:.4f}; frozen on the rest:</p>",
        table(["captures", "response", "rows", "rms error %", "median z"], frozen),
        "<p>isetval compare with the whole model, nuisances refitted on each part:</p>",
        table(["captures", "model", "n", "mean-square z", "rms error %"], ladder),
        named,
    ]
