"""An answer held against the truth."""

from __future__ import annotations

FLAGS = ("unexplained", "partial")
RIGHT = ("right", "")


def judged(row):
    """What a trial's answer was worth: detected, first name, further names, pulls, and why it is wrong in words."""
    answer = row["answer"]
    if answer is None or answer.get("verdict", "unfinished") == "unfinished":
        reason = row["error"] or "; ".join((answer or {}).get("not_looked_at", ())) or "no answer"
        return {"answered": False, "right": False, "outcome": "no answer", "why": reason, "named": []}
    named = [effect["name"] for effect in answer["effects"]]
    out = {
        "answered": True,
        "verdict": answer["verdict"],
        "named": named,
        "detected": answer["verdict"] != "consistent",
        "flagged": answer["verdict"] in FLAGS,
        "posterior": answer["effects"][0]["posterior"] if named else None,
    }
    found = _matched(row["truths"], answer["effects"])
    out["first_right"] = bool(named) and 0 in found.values() if row["truths"] else not named
    out["found"] = len(found)
    out["extra"] = [name for i, name in enumerate(named) if i not in found.values()]
    out["pulls"] = _pulls(row["truths"], answer["effects"], found)
    out |= _outcome(row, out)
    return out


def _matched(truths, effects):
    """Index of the named effect that stands for each truth: the same name, or one of its class."""
    found = {}
    for i, truth in enumerate(truths):
        names = {truth["name"], *truth["also"]} - {""}
        for j, effect in enumerate(effects):
            members = {effect["name"], *effect["equivalent"]}
            if j not in found.values() and (effect["name"] in names or (truth["name"] and truth["name"] in members)):
                found[i] = j
                break
    return found


def _pulls(truths, effects, found):
    """(found - true) / sigma of every parameter whose effect was named by its own name."""
    out = {}
    for i, j in found.items():
        if effects[j]["name"] != truths[i]["name"]:
            continue
        for key, value in truths[i]["values"].items():
            fitted = effects[j]["parameters"].get(key)
            if fitted and fitted["sigma"]:
                out[f"{effects[j]['name']}.{key}"] = (fitted["value"] - value) / fitted["sigma"]
    return out


def _outcome(row, j):
    """One word for the matrix, whether that is right, and a sentence where it is not."""
    names = ", ".join(j["named"]) or "nothing"
    if row["kind"] == "null":
        right = j["verdict"] == "consistent"
        return {"outcome": "consistent" if right else _wrong(j), "right": right, "why": "" if right else _why(row, j)}
    if row["kind"] == "outsider":
        if j["found"]:
            return {"outcome": "named rightly", "right": True, "why": ""}
        if j["flagged"]:
            return {"outcome": "flagged", "right": True, "why": ""}
        outcome = "named without a flag" if j["named"] else "not seen"
        return {"outcome": outcome, "right": False, "why": f"verdict {j['verdict']}, named {names}"}
    if not j["detected"]:
        return {"outcome": "not seen", "right": False, "why": _why(row, j)}
    if j["found"] == len(row["truths"]) and not j["extra"]:
        return {"outcome": "right", "right": True, "why": ""}
    if j["first_right"]:
        outcome = "right and more" if j["extra"] else "one of two"
    else:
        outcome = "named wrongly" if j["named"] else "flagged without a name"
    return {"outcome": outcome, "right": False, "why": _why(row, j)}


def _wrong(j):
    return "named" if j["named"] else "flagged" if j["flagged"] else j["verdict"]


def _why(row, j):
    """What the answer said, and what the scores of the first round put where."""
    truth = " and ".join(t["name"] or "an outsider" for t in row["truths"]) or "nothing"
    best = [f"{c['name']} {c['dchi2']:.0f}" for c in row["answer"]["candidates"][:4]]
    left = f"; left: {row['answer']['leftover'][:120]}" if row["answer"]["leftover"] else ""
    words = ", ".join(j["named"]) or "nothing"
    return f"hidden {truth}; verdict {j['verdict']}, named {words}; best scores {', '.join(best)}{left}"
