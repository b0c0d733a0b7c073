"""Words for comparisons, identifiability and diagnoses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from isetval.app.cli.tables import text_table
from isetval.app.remarks import gathered
from isetval.app.report.budget_parts import budget
from isetval.app.words import chance_words, effect_words, probability_words, relative_words, state_of, verdict_words, with_sigma

FITTED = {
    "prediction": "nothing was fitted to these captures",
    "calibration": "an effect of one of these models was fitted to these captures",
}

CHANCES = {"nothing": "nothing is missing", "unknown": "something is at work that the catalogue does not hold"}


def gate_line(gate: Mapping[str, Any]) -> str:
    """The repeat gate in one line."""
    if not gate.get("run"):
        reason = gate.get("reason") or "the campaign declares no repeats (repeat_of); error bars are taken as stated"
        return f"repeat gate: not run, {reason}"
    words = "failed" if gate["failed"] else "passed"
    nominal = gate.get("nominal_mean_square_z")
    bars = "" if nominal is None else f", {nominal:.3f} with the error bars of the first model"
    return (
        f"repeat gate: {words}; mean-square z of {gate['n']} repeated numbers {gate['mean_square_z']:.3f} "
        f"(1 +- {gate['allowed']:.2f} allowed{bars})"
    )


def ladder_table(ladder: Sequence[Mapping[str, Any]]) -> list[str]:
    """Families against models: mean-square z and rms relative error, captures that were fitted to apart from others."""
    out: list[str] = []
    for role, captures in dict.fromkeys((row["role"], row.get("captures", "")) for row in ladder):
        rows = [row for row in ladder if (row["role"], row.get("captures", "")) == (role, captures)]
        models = list(dict.fromkeys(row["model"] for row in rows))
        families = list(dict.fromkeys(row["family"] for row in rows))
        cell = {(row["family"], row["model"]): row for row in rows}
        where = f" ({captures})" if captures else ""
        out.append("# mean-square z (1 = agrees within the error bars, ? doubtful, ! fails) and rms relative error")
        out.append(f"  {role}: {FITTED[role]}{where}")
        body = []
        for family in families:
            entries = [cell.get((family, m)) for m in models]
            n = next(e["n"] for e in entries if e)
            body.append((family, n, *(_cell(e) for e in entries)))
        out += text_table(("family", "n", *models), body)
    return out


def _cell(row: Mapping[str, Any] | None) -> str:
    if row is None or row["mean_square_z"] is None:
        return "-"
    mark = {"fails": " !", "doubtful": " ?"}.get(state_of(row["mean_square_z"], row["n"]), "")
    relative = relative_words(row)
    return f"{row['mean_square_z']:.3f}{mark}" + (f" ({relative})" if relative else "")


def comparison_lines(result: Mapping[str, Any]) -> list[str]:
    """Gate, families, worst conditions, nuisances that were pulled."""
    lines = [gate_line(result["gate"]), ""]
    lines += ladder_table(result["ladder"])
    lines += _worst_lines(result)
    lines += _budget_lines(result)
    lines += [f"note: {note}" for note in gathered(result["notes"])]
    return lines


def _worst_lines(result: Mapping[str, Any], count: int = 8) -> list[str]:
    model = result["models"][-1]
    rows = [row for row in result["table"] if row["model"] == model and row["z"] is not None]
    rows.sort(key=lambda row: -abs(row["z"]))
    body = [
        (
            row["name"],
            row["shot"],
            row["channel"],
            row["region"] or row["patch"] or (f"{row['frequency_cy_px']:g} cy/px" if row["frequency_cy_px"] else ""),
            f"{row['measured']:.5g}",
            f"{row['simulated']:.5g}",
            row["unit"],
            f"{row['z']:+.1f}",
        )
        for row in rows[:count]
    ]
    header = ("metric", "shot", "channel", "at", "measured", "simulated", "unit", "z")
    return ["", f"# farthest single metrics ({model}, of {len(rows)})", *text_table(header, body)] if body else []


def _budget_lines(result: Mapping[str, Any]) -> list[str]:
    """Families with more than their error bars explain: what it is; of the others, what would make the error bars smaller."""
    rows = budget(result)
    if not rows:
        return []
    beyond = [row for row in rows if row["beyond"]]
    words = {share["key"]: share["words"] for row in rows for share in row["shares"]}
    body = []
    for row in beyond:
        largest = max(row["shares"], key=lambda share: share["percent"])
        excess = [row[key] or "-" for key in ("repeat", "region", "misfit")]
        body.append((row["family"], f"{words[largest['key']]} {largest['percent']:.0f} %", *excess, row["helps"]))
    header = ("family", "largest part of its error bars", "repeats", "regions", "model", "what would help")
    lines = ["", f"# error budget ({result['models'][-1]}): what lies beyond the error bars, in units of their variance"]
    lines += text_table(header, body) if body else ["  nothing"]
    rest = [row for row in rows if not row["beyond"]]
    for remedy in dict.fromkeys(row["helps"] for row in rest):
        lines.append(
            f"  nothing beyond; {remedy} would narrow: {', '.join(row['family'] for row in rest if row['helps'] == remedy)}"
        )
    return lines


def identify_lines(result: Mapping[str, Any]) -> list[str]:
    """Detectable parameters, hidden effects, close pairs, captures that would help."""
    body = [
        (
            p["effect"],
            p["parameter"],
            f"{p['sigma']:.3g}",
            _or_dash(p["half_detectable"]),
            _or_dash(p["smallest_detectable"]),
            f"{p['tau']:.3g}",
            p["unit"],
        )
        for p in result["parameters"]
        if p["observable"] and p["sigma"] is not None
    ]
    lines = ["# effects that this plan would show (sigma of each parameter, strengths found with 50 and 95 % power)"]
    lines += text_table(("effect", "parameter", "sigma", "50 %", "95 %", "plausible", "unit"), body)
    lines += ["", f"not observable with this plan: {', '.join(result['unobservable']) or 'none'}"]
    if result["pairs"]:
        lines += ["", "# pairs that are hard to tell apart (cosine rho of their signatures)"]
        rows = [(*p["effects"], f"{p['rho']:.3f}", *_next_words(p.get("next"))) for p in result["pairs"][:12]]
        lines += text_table(("effect", "effect", "rho", "then", "next capture"), rows)
    return lines + next_lines(result["next_captures"])


def _next_words(found: Mapping[str, Any] | None) -> tuple[str, str]:
    return ("-", "none of those tried") if found is None else (f"{found['rho_after']:.3f}", found["capture"])


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def next_lines(captures: Sequence[Mapping[str, Any]]) -> list[str]:
    """Captures that would tell close pairs apart."""
    if not captures:
        return []
    body = [(c["capture"], " / ".join(c["separates"]), f"{c['rho_before']:.3f} -> {c['rho_after']:.3f}") for c in captures]
    return ["", "# captures that would tell them apart", *text_table(("capture", "separates", "rho"), body)]


def diagnosis_lines(result: Mapping[str, Any], hint: Mapping[str, Any] | None = None) -> list[str]:
    """Verdict, named effects, table of candidates, what is left, what next, the ladder."""
    lines = [gate_line(result["gate"]), "", f"# verdict: {result['verdict']} - {verdict_words(result)}"]
    for effect in result["effects"]:
        lines.append(f"  {effect_words(effect)}")
        also = f"; these captures cannot tell it from {', '.join(effect['equivalent'])}" if effect["equivalent"] else ""
        low, high = effect.get("posterior_range", (effect["posterior"],) * 2)
        scan = f" ({low:.2f} to {high:.2f} with prior widths 3 times wider or narrower)" if high - low > 0.01 else ""
        lines.append(f"    posterior {probability_words(effect['posterior'], 3)}{scan}{also}")
        lines += _form_lines(effect)
    lines += _rival_lines(result)
    chances = result.get("probabilities") or {}
    if chances:
        said = ", ".join(f"{words} {probability_words(chances[key], 3)}" for key, words in CHANCES.items() if key in chances)
        lines.append(f"  probability that {said}")
    if result["leftover"]:
        lines.append(f"  left over: {result['leftover']}")
    if result.get("not_looked_at"):
        lines.append(f"  not looked at: {'; '.join(result['not_looked_at'])}")
    lines += _candidate_lines(result["candidates"])
    lines += ["", f"not observable with these captures: {', '.join(result['unobservable']) or 'none'}"]
    lines += next_lines(result["next_captures"])
    lines += ["", *ladder_table(result["ladder"])]
    lines += [f"note: {note}" for note in gathered(result["notes"])]
    stands = result["verdict"] != "unfinished"  # what a search holds when it is stopped may be taken back
    if hint and result["effects"] and stands:
        first = f" {result['effects'][0]['name']}" if len(result["effects"]) == 1 else ""  # none: all of them
        kept = "" if hint["kept"] else f" (after the same with -o {hint['diagnosis']}, which keeps this result)"
        lines += ["", f"next: isetval add {hint['model']}{first} --from {hint['diagnosis']} -o model2.toml{kept}"]
    return lines


def _candidate_lines(candidates: Sequence[Mapping[str, Any]], count: int = 8) -> list[str]:
    seen = [c for c in candidates if c["observable"]]
    if not seen:
        return []
    body = []
    for c in sorted(seen, key=lambda c: (c["p_corrected"], -(c["dchi2"] or 0)))[:count]:
        estimate = _estimate_words(c)
        posterior = "" if c["posterior"] is None else f"{c['posterior']:.3f}"
        body.append((c["name"], estimate, f"{c['dchi2']:.1f}", chance_words(c["p_corrected"]), posterior))
    header = ("candidate", "one-step estimate", "dchi2", "p (look-elsewhere)", "posterior")
    return ["", f"# suspects (of {len(seen)} observable candidates)", *text_table(header, body)]


def _estimate_words(candidate: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {with_sigma(p['value'], p['sigma'])}" for name, p in candidate["estimate"].items())


RIVALS_TOLD = 3
HALF = 0.5  # of what the named effect explains: from there on a suspect is a rival


def _rival_lines(result: Mapping[str, Any]) -> list[str]:
    """What else alone would explain at first sight at least half of what the first named effect does."""
    best: dict[str, Mapping[str, Any]] = {}
    for c in sorted(result["candidates"], key=lambda c: -(c["dchi2"] or 0.0)):
        best.setdefault(c["name"].split(" (")[0], c)  # of the forms of one effect that which explains most
    named = [effect["name"] for effect in result["effects"]]
    whole = best[named[0]]["dchi2"] if named and named[0] in best else None
    if not whole:
        return []
    seen = [c for name, c in best.items() if name not in named and c["observable"]]
    rivals = [c for c in seen if (c["dchi2"] or 0.0) > HALF * whole][:RIVALS_TOLD]
    # a first step from the nominal model may promise more than the fit found: of what is named no more than all can be explained
    told = [f"{c['name']} {min(100 * c['dchi2'] / whole, 100):.0f} % ({_estimate_words(c)})" for c in rivals]
    return (
        [f"  rivals of {named[0]}, by what each alone explains at first sight of what it does: {'; '.join(told)}"] if told else []
    )


def _form_lines(effect: Mapping[str, Any]) -> list[str]:
    """The form that was chosen, and by how much the others are less likely."""
    forms = effect.get("forms") or []
    if not forms:
        return []
    fewest = min((f["free"] for f in forms), key=len)
    named = [f["form"] + _further([name for name in f["free"] if name not in fewest], f["form"]) for f in forms]
    behind = [f["log_evidence"] - forms[0]["log_evidence"] for f in forms]
    others = ", ".join(f"{name} {by:+.1f}" for name, by in zip(named[1:], behind[1:][:RIVALS_TOLD], strict=False))
    more = f", and {len(named) - 1 - RIVALS_TOLD} more" if len(named) - 1 > RIVALS_TOLD else ""
    return [f"    form: {named[0]}; ln evidence of others against it: {others}{more}"]


def _further(names: Sequence[str], form: str) -> str:
    """What is free in a form beside what is free in all."""
    shapes = [name for name in names if not name.startswith("free_")]
    curve = ["a curve"] if len(shapes) < len(names) and "free" not in form else []
    return f" with {', '.join([*shapes, *curve])}" if shapes or curve else ""


def demo_lines(result: Mapping[str, Any]) -> list[str]:
    """The end of the demo in words: before, verdict, ladder, reveal, report."""
    diagnosis, hidden = result["diagnosis"], result["hidden"]
    lines = ["", f"# verdict: {diagnosis['verdict']} - {verdict_words(diagnosis)}"]
    for effect in diagnosis["effects"]:
        also = f"; not to be told from {', '.join(effect['equivalent'])}" if effect["equivalent"] else ""
        lines.append(f"  {effect_words(effect)} (posterior {probability_words(effect['posterior'])}{also})")
    if diagnosis["leftover"]:
        lines.append(f"  left over: {diagnosis['leftover']}")
    lines += ["", *ladder_table(result["after"]["ladder"]), ""]
    named = [e["name"] for e in diagnosis["effects"]]
    right = hidden["name"] in named or any(hidden["name"] in e["equivalent"] for e in diagnosis["effects"])
    truth = ", ".join(f"{k} {p['value']:.4g} {p['unit']}" for k, p in hidden["parameters"].items())
    lines.append(f"# hidden was: {hidden['name']} ({truth}) - {'found' if right else 'NOT found'}")
    memory = f", {result['peak_memory_mb']:.0f} MB" if result.get("peak_memory_mb") else ""
    return [*lines, f"report: {result['report']}", f"({result['seconds']:.0f} s{memory}; files in {result['folder']})"]
