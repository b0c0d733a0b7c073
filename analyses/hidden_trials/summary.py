"""Sums over judged trials: shares with their binomial intervals, beside the numbers that are asked for."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from itertools import pairwise

import numpy as np

from hidden_trials.nearest import tells_apart

KINDS = ("null", "single", "pair", "form", "outsider")
QUIET = ("consistent", "no answer")
UNFLAGGED = "named without a flag"
BINS = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0001)


def interval(k, n, z=1.96):
    """Wilson's 95 % interval of a share (Wilson 1927)."""
    if n == 0:
        return (0.0, 1.0)
    p, d = k / n, 1 + z * z / n
    middle, half = (p + z * z / (2 * n)) / d, z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / d
    return (min(max(0.0, middle - half), p), max(min(1.0, middle + half), p))  # rounding must not leave the share outside


def share(rows, right):
    """Count, n, share, interval."""
    k, n = sum(map(bool, map(right, rows))), len(rows)
    low, high = interval(k, n)
    return {"k": k, "n": n, "share": k / n if n else None, "low": low, "high": high}


def targets(rows):
    """(what, target, measured) in the order of the issue; ``rows`` are (trial row, judgement) pairs.

    A trial without an answer in time counts as wrong wherever an answer would have been right.
    """

    def of(*kinds):
        return [r for r in rows if r[0]["kind"] in kinds]

    def at(found, level):
        return [r for r in found if r[0]["level"] == level]

    def extra(r):
        return r[1]["extra"]

    def unflagged(r):
        return r[1]["outcome"] == UNFLAGGED

    def seen(found):
        return [r for r in found if r[1].get("detected")]

    single, pair, form, outsider = (of(k) for k in ("single", "pair", "form", "outsider"))
    strong = [r for r in single if r[0]["level"] in (8.0, 15.0)]
    first, faint = (lambda r: r[1].get("first_right")), (lambda r: bool(r[1].get("named")) and not r[1]["first_right"])
    practice = at(single, "practice")
    loud = [r for r in practice if (r[0]["expected_s"][0] or 0) >= 8]
    out_strong = [r for r in outsider if (r[0]["expected_s"][0] or 0) >= 8]
    return [
        ("false attribution on nulls", "<= 1 %", share(of("null"), lambda r: r[1]["outcome"] not in QUIET)),
        ("nulls answered", "100 %", share(of("null"), lambda r: r[1]["answered"])),
        ("detection at s = 5", ">= 90 %", share(at(single, 5.0), lambda r: r[1].get("detected"))),
        ("detection at s = 8", ">= 99 %", share(at(single, 8.0), lambda r: r[1].get("detected"))),
        ("right class first, detected, s = 5", ">= 93 %", share(seen(at(single, 5.0)), first)),
        ("right class first, detected, s >= 8", ">= 98 %", share(seen(strong), first)),
        ("wrong name at s = 3", "<= 5 %", share(at(single, 3.0), faint)),
        ("right, as met in practice (s >= 8)", "100 %", share(loud, first)),
        ("right, as met in practice (all)", "-", share(practice, first)),
        ("wrong additional effect (singles named rightly)", "<= 3 %", share([r for r in single if first(r)], extra)),
        ("pairs exact, s = 8", ">= 85 %", share(at(pair, 8.0), lambda r: r[1]["right"])),
        ("pairs exact, s = 15", ">= 95 %", share(at(pair, 15.0), lambda r: r[1]["right"])),
        ("wrong forms: class right, no second name (detected)", ">= 90 %", share(seen(form), lambda r: r[1]["right"])),
        ("outsiders named without a flag (s >= 8)", "<= 5 %", share(out_strong, unflagged)),
        ("outsiders flagged or named rightly (s >= 8)", ">= 90 %", share(out_strong, lambda r: r[1]["right"])),
        ("outsiders 5 sigmas from any effect: no flag", "<= 5 %", share([r for r in out_strong if tells_apart(r[0])], unflagged)),
        ("95 % intervals that hold the truth", "92 to 97 %", share(pulls(rows), lambda p: abs(p[1]) <= 1.96)),
    ]  # fmt: skip


def pulls(rows):
    """(parameter, pull, trial) of all parameters whose effect was named by its own name."""
    return [(key, pull, r[0]["id"]) for r in rows for key, pull in r[1].get("pulls", {}).items()]


def reliability(rows):
    """Stated posterior of the first name against how often its class was right, by bins."""
    stated = [(r[1]["posterior"], bool(r[1]["first_right"])) for r in rows if r[1].get("named")]
    out = []
    for low, high in pairwise(BINS):
        own = [right for p, right in stated if low <= p < high]
        if own:
            mean = float(np.mean([p for p, _ in stated if low <= p < high]))
            out.append({"from": low, "to": min(high, 1.0), "stated": mean, **share(own, bool)})
    brier = float(np.mean([(p - right) ** 2 for p, right in stated])) if stated else None
    return {"bins": out, "brier": brier, "n": len(stated)}


def confusion(rows):
    """Counts of (hidden class, first name) over all trials with one thing hidden, or none."""
    counts = Counter()
    for row, j in rows:
        if row["kind"] == "pair" or not j["answered"]:
            continue
        truth = next((t["name"] or next(iter(row["hidden"])) for t in row["truths"]), "nothing")
        if row["kind"] == "outsider":
            truth = "outside: " + next(iter(row["hidden"]))
        said = j["named"][0] if j["named"] else ("flag only" if j["flagged"] else "nothing")
        counts[truth, said] += 1
    return [{"hidden": a, "said": b, "n": n} for (a, b), n in sorted(counts.items())]


def power(rows):
    """Share detected and share rightly named against the expected significance, singles."""
    out = []
    for low, high in ((0, 4), (4, 6.5), (6.5, 11), (11, 20), (20, 50), (50, 1e9)):
        own = [r for r in rows if r[0]["kind"] == "single" and r[0]["expected_s"][0] and low <= r[0]["expected_s"][0] < high]
        if own:
            s = float(np.median([r[0]["expected_s"][0] for r in own]))
            right = share(own, lambda r: r[1].get("first_right") and r[1].get("named"))
            out.append({"s": s, "detected": share(own, lambda r: r[1].get("detected")), "right": right})
    return out


def families(rows):
    """Mean-square z of each family on nulls (nothing but nuisances fitted), pooled over sessions with its scatter over them."""
    sums = defaultdict(list)
    for row, j in rows:
        if row["kind"] != "null" or not j["answered"]:
            continue
        for line in row["answer"]["ladder"]:
            if line["role"] == "prediction" and line["mean_square_z"] is not None and line["n"]:
                sums[line["family"]].append((line["mean_square_z"], line["n"]))
    out = []
    for family, values in sorted(sums.items()):
        z2, n = np.array(values).T
        scatter = float(np.std(z2, ddof=1) / math.sqrt(len(z2))) if len(z2) > 1 else math.sqrt(2 / n.sum())
        mean = float(np.sum(z2 * n) / n.sum())
        out.append({"family": family, "mean_square_z": mean, "error": scatter, "rows": int(n.mean()), "sessions": len(z2)})
    return out


def against_oracle(rows):
    """Held-out mean-square z: nominal, found, true model (the catalogue's effect at its true value)."""
    out = []
    for row, j in rows:
        if not j["answered"]:
            continue
        held = [r for r in row["answer"]["ladder"] if r["role"] == "prediction" and r["family"] == "all"]
        said = [r["mean_square_z"] for r in held if r["captures"] == held[-1]["captures"]]
        true = [r["mean_square_z"] for r in row["answer"].get("oracle", ()) if r["family"] == "all"]
        if said and true and j["right"]:
            out.append({"id": row["id"], "nominal": said[0], "found": said[-1], "oracle": true[0]})
    return out


def summary(rows):
    """All sums, as they are stored."""
    oracle = against_oracle(rows)
    gaps = [o["found"] - o["oracle"] for o in oracle]
    outcomes = {kind: dict(Counter(j["outcome"] for r, j in rows if r["kind"] == kind)) for kind in KINDS}
    cpu_s = [r["cpu_s"] for r, _ in rows]
    return {
        "n": len(rows),
        "by_kind": outcomes,
        "targets": [{"what": what, "target": target, **found} for what, target, found in targets(rows)],
        "reliability": reliability(rows),
        "confusion": confusion(rows),
        "power": power(rows),
        "families_on_nulls": families(rows),
        "against_oracle": {
            "n": len(gaps),
            "median_gap": float(np.median(gaps)) if gaps else None,
            "largest_gap": max(gaps, default=None),
            "rows": oracle,
        },
        "pulls": [{"parameter": key, "pull": pull, "id": trial} for key, pull, trial in pulls(rows)],
        "cpu_s": {"median": float(np.median(cpu_s)), "total": float(sum(cpu_s))},
        "wrong": [_told(r, j) for r, j in rows if not j["right"] and not _too_faint(r, j)],
    }


def _told(row, j):
    """A wrong answer with what is needed to look into it."""
    kept = ("id", "kind", "level", "hidden", "expected_s", "lens", "other_specimen")
    return {key: row[key] for key in kept} | {"outcome": j["outcome"], "why": j["why"]}


def _too_faint(row, j):
    """Not seen, where nobody could: below 5 sigmas."""
    return j["outcome"] == "not seen" and bool(row["expected_s"]) and max(s or 0.0 for s in row["expected_s"]) < 5.0


def table_lines(found):
    """Target, measured, n, as text."""
    head = f"{'what':55s} {'target':>12s} {'measured':>10s} {'95 % interval':>16s} {'n':>5s}"
    lines = [head]
    for row in found["targets"]:
        measured = "-" if row["share"] is None else f"{100 * row['share']:.1f} %"
        span = "" if row["share"] is None else f"{100 * row['low']:.1f} to {100 * row['high']:.1f} %"
        lines.append(f"{row['what']:55s} {row['target']:>12s} {measured:>10s} {span:>16s} {row['n']:5d}")
    for b in found["reliability"]["bins"]:
        words = f"posterior {b['from']:.2f} to {b['to']:.2f}: stated {b['stated']:.3f}"
        span = f"{100 * b['low']:.1f} to {100 * b['high']:.1f} %"
        lines.append(f"{words:55s} {'within .03':>12s} {100 * b['share']:8.1f} % {span:>16s} {b['n']:5d}")
    wrong = found.get("confusions", [])
    if wrong:
        k = sum(w["rho"] is not None for w in wrong)
        words = f"{k} of {len(wrong)}, {sum((w['rho'] or 0) > 0.95 for w in wrong)} above .95"
        lines.append(f"{'wrong names that identify predicted (rho > .7)':55s} {'>= 90 %':>12s} {words:>27s} {len(wrong):5d}")
    gap = found["against_oracle"]
    if gap["n"]:
        words = f"{gap['median_gap']:+.3f} ({gap['largest_gap']:+.3f} at most)"
        lines.append(f"{'held-out mean-square z above the oracle, median':55s} {'.02':>12s} {words:>27s} {gap['n']:5d}")
    for row in found["families_on_nulls"]:
        words = f"{row['mean_square_z']:.3f} +- {row['error']:.3f}"
        lines.append(f"{'nulls, mean-square z of ' + row['family']:55s} {'.9 to 1.1':>12s} {words:>27s} {row['sessions']:5d}")
    return lines
