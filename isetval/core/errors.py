"""Errors for people: what, where, found, needed, what to do."""


class InputError(ValueError):
    """Input that a person can mend: a file, a region, a value.

    The message is one or two sentences that name the place, the value found, the value needed and
    the remedy.  The command line turns it into exit code 3 without a traceback.
    """


class MeasurementError(InputError):
    """An analysis cannot give an honest number for this capture or region."""


class MissingPartError(RuntimeError):
    """An optional part of the machine (LLVM, a browser, exiftool) is missing; exit code 4."""
