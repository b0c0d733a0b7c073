"""Errors for people: what, where, found, needed, what to do."""

LONGEST = 1500  # characters of a message: a screen; what a file holds may be longer


def sentence(words: str) -> str:
    """A message that a terminal can show: control characters as their codes, the middle of what is too long left out."""
    if len(words) > LONGEST:
        words = f"{words[: LONGEST - 400]} [...] {words[-400:]}"
    if words.isprintable():
        return words
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in words)


class InputError(ValueError):
    """Input that a person can mend: a file, a region, a value.

    The message is one or two sentences that name the place, the value found, the value needed and
    the remedy.  The command line turns it into exit code 3 without a traceback.
    """

    def __init__(self, *words: object) -> None:
        super().__init__(*(sentence(word) if isinstance(word, str) else word for word in words))


class MeasurementError(InputError):
    """An analysis cannot give an honest number for this capture or region."""


class MissingPartError(RuntimeError):
    """An optional part of the machine (LLVM, a browser, exiftool) is missing; exit code 4."""
