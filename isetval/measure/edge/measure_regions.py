"""``sfr`` and ``sfr_batch``: from a capture and a region to a result with a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, check_roi
from isetval.core.errors import InputError
from isetval.core.sensor import RoiLike
from isetval.core.threads import one_blas_thread
from isetval.measure.edge.alternating_fit import FittedEdges, measure_edges
from isetval.measure.edge.choices import Choices, checked_choices
from isetval.measure.edge.clipped_tails import STEPS, cut_tails, restored
from isetval.measure.edge.first_look import FirstLooks, first_look, first_width, prospects
from isetval.measure.edge.geometry import Stack, same_grid, stacked
from isetval.measure.edge.iso12233 import compatibility_sfr
from isetval.measure.edge.result_of_fit import Request, refused, results_of_fit
from isetval.measure.edge.samples import Oecf, Samples, check_channel, linearised, plane_samples, too_small
from isetval.measure.edge.sfr_result import SfrResult
from isetval.measure.edge.verdict import Seen

Float = NDArray[np.floating[Any]]


METHODS = ("default", "iso12233:2000", "iso12233:2017", "iso12233:2023", "lyu2022")
ROUNDING_VARIANCE = 1 / 12  # DN^2, of a uniform error of one code
STEEP = 1.03  # dx/dy above which rows and columns are exchanged: 1 with a margin against edges at 45 degrees turned to and fro
STACKED_SAMPLES = 250_000  # 2 MB of doubles, about a core's second-level cache; results do not depend on it


def sfr(
    capture: Capture,
    roi: RoiLike | None = None,
    channel: str = "G",
    *,
    method: str = "default",
    choices: Mapping[str, Any] | None = None,
    oecf: Oecf = None,
) -> SfrResult:
    """Slanted-edge spatial frequency response of one region.

    Parameters
    ----------
    capture : Capture
        Raw mosaic or one-channel image, linear.
    roi : (row0, row1, col0, col1), half open, or None
        Region with one edge; None is the whole capture.
    channel : str
        ``R``, ``Gr``, ``Gb``, ``B`` or ``G`` (both greens, on the mosaic); ignored for one-channel captures.
    method : str
        ``default``; ``iso12233:2000``, ``iso12233:2017``, ``iso12233:2023``: the published procedures; ``lyu2022``: the 2003-era
        procedure behind the paper's curves (demosaiced luminance, no slant and no derivative correction).
    choices : mapping or None
        ``choices`` of another result, to make the same data-driven choices (order of the edge, width and stiffness of the
        spline, noise that samples are weighted by) again.
    oecf : "srgb", number, pairs or None
        Curve of a rendered image, to be undone first: see ``isetval.measure.edge.samples.oecf_table``.  Raw data need none.

    Returns
    -------
    SfrResult
        ``flags`` names the reasons when the edge is refused; its numbers are NaN then.

    Raises
    ------
    InputError
        For a region outside the capture, an unknown channel or method.
    """
    if not isinstance(capture, Capture):
        raise InputError(f"sfr needs a Capture, not {type(capture).__name__}; see Capture.from_array")
    return sfr_batch(capture, [roi], channel, method=method, choices=choices, oecf=oecf)[0]


@one_blas_thread()
def sfr_batch(
    captures: Capture | Sequence[Capture],
    rois: Sequence[RoiLike | None],
    channel: str | Sequence[str] = "G",
    *,
    method: str = "default",
    choices: Mapping[str, Any] | Sequence[Mapping[str, Any] | None] | None = None,
    oecf: Oecf = None,
) -> list[SfrResult]:
    """``sfr`` of many regions: of one capture or of as many as regions, likewise channels and choices.

    Regions whose grids of samples are alike are measured together, a red and a blue one too, in less time than one by one.

    Raises
    ------
    InputError
        When the numbers of captures, channels or choices and of regions differ.
    """
    if method not in METHODS:
        raise InputError(f"method is {method!r}; it needs one of {', '.join(METHODS)}")
    if not hasattr(rois, "__len__"):
        raise InputError(f"rois is a {type(rois).__name__}; it needs a list of regions, None for a whole capture")
    many = _each("captures", captures, rois)
    channels = _each("channels", [channel] * len(rois) if isinstance(channel, str) else channel, rois)
    chosen = [checked_choices(own) for own in _each("choices", choices, rois)]
    asked = zip(many, rois, channels, chosen, strict=True)
    jobs = [_job(c, r, k, i, oecf, own) for i, (c, r, k, own) in enumerate(asked)]
    if method != "default":
        return [compatibility_sfr(job.capture, job.roi, channel=job.channel, method=method, oecf=oecf) for job in jobs]
    out: dict[int, SfrResult] = {}
    for group in _groups([_sampled(job) for job in jobs], out):
        _measure(group, out)
    return [out[i] for i in range(len(jobs))]


def _each(what: str, given: Any, rois: Sequence[RoiLike | None]) -> list[Any]:
    """One for each region: what is given for all of them, or as many."""
    if not isinstance(given, Sequence):
        return [given] * len(rois)
    if len(given) != len(rois):
        raise InputError(f"{len(given)} {what} and {len(rois)} regions; give one for all of them, or one for each")
    return list(given)


@dataclass(frozen=True, eq=False)
class _Job(Request):
    """One region to be measured; ``turned`` once rows and columns were exchanged after the first look."""

    index: int = 0
    samples: Samples | None = None
    turned: bool = False
    refusal: Mapping[str, str] | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)


def _job(capture: Capture, roi: RoiLike | None, channel: str, index: int, oecf: Oecf, choices: Mapping[str, Any]) -> _Job:
    if not isinstance(capture, Capture):
        raise InputError(f"sfr needs a Capture, not {type(capture).__name__}; see Capture.from_array")
    try:
        box = check_roi(capture, roi)
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"roi is {roi!r}; it needs four whole numbers (row0, row1, col0, col1), half open") from error
    return _Job(capture, box, check_channel(capture, channel), oecf, index, choices=choices)


def _sampled(job: _Job) -> _Job:
    """The job with its samples, or with the reason why the region is too small."""
    box = job.roi
    if min(box[1] - box[0], box[3] - box[2]) < 8:
        message = f"the region is {box[1] - box[0]} x {box[3] - box[2]} px; enlarge it"
        return replace(job, refusal={"roi_too_small": message})
    samples = linearised(plane_samples(job.capture, box, job.channel), job.capture, job.oecf)
    small = too_small(samples, job.channel)
    return replace(job, refusal={"roi_too_small": small}) if small else replace(job, samples=samples)


def _groups(jobs: Sequence[_Job], out: dict[int, SfrResult]) -> list[list[_Job]]:
    """Jobs with equal grids and the same names chosen, few enough at a time to stay in the processor's cache.

    Refused ones go to ``out``.
    """
    kinds: dict[Any, list[_Job]] = {}
    for job in jobs:
        if job.refusal is not None or job.samples is None:
            out[job.index] = refused(job.capture, job.roi, channel=job.channel, flags=job.refusal or {})
        else:
            kinds.setdefault((same_grid(job.samples), *sorted(job.choices)), []).append(job)
    groups = []
    for same in kinds.values():
        n = max(1, STACKED_SAMPLES // _samples_of(same[0]).values.size)
        groups += [same[i : i + n] for i in range(0, len(same), n)]
    return groups


def _samples_of(job: _Job) -> Samples:
    assert job.samples is not None
    return job.samples


def _measure(jobs: list[_Job], out: dict[int, SfrResult]) -> None:
    """Measure jobs with equal grids."""
    stack = stacked([_samples_of(job) for job in jobs])
    looks = first_look(stack)
    steep = looks.exists & (np.abs(looks.lines.middle[1]) > STEEP) & ~np.array([job.turned for job in jobs])
    if steep.any():
        turned = [_turned(jobs[i]) for i in np.flatnonzero(steep)]
        for group in _groups(turned, out):
            _measure(group, out)
        keep = np.flatnonzero(~steep)
        jobs, stack, looks = [jobs[i] for i in keep], stack.pick(keep), looks.pick(keep)
    if not jobs:
        return
    width = first_width(stack, looks)
    before = prospects(stack, looks, width)
    for job, reason in zip(jobs, before.reasons, strict=True):
        if reason is not None:
            flags = dict([reason]) | _saturated(_samples_of(job))
            out[job.index] = refused(job.capture, job.roi, channel=job.channel, flags=flags)
    good = np.flatnonzero([reason is None for reason in before.reasons])
    if len(good) < len(jobs):
        jobs, stack, looks = [jobs[i] for i in good], stack.pick(good), looks.pick(good)
    if not jobs:
        return
    for fitted in _fitted(stack, looks, width[good], Choices.of([job.choices for job in jobs])):
        places = fitted.places
        seen = Seen((looks.bright - looks.dark)[places], before.noise_dn[good[places]])
        asked = [jobs[i] for i in places]
        for job, result in zip(asked, results_of_fit(asked, fitted, seen), strict=True):
            out[job.index] = result
    for job in jobs:
        if job.index not in out:
            message = "no single edge explains the region; choose a region with one edge"
            out[job.index] = refused(job.capture, job.roi, channel=job.channel, flags={"two_edges": message})


def _turned(job: _Job) -> _Job:
    samples = plane_samples(job.capture, job.roi, job.channel, transposed=not _samples_of(job).transposed)
    return replace(job, samples=linearised(samples, job.capture, job.oecf), turned=True)


def _fitted(stack: Stack, looks: FirstLooks, width_px: Float, choices: Choices) -> list[FittedEdges]:
    """Fitted edges; those whose noise is cut off at white are fitted again with what was cut off."""
    out = []
    for fitted in _fitted_as_is(stack, looks, width_px, choices):
        again = cut_tails(fitted)
        whole = np.setdiff1d(np.arange(len(fitted)), again)
        out += [fitted.pick(whole)] if len(whole) else []
        out += _fitted_with_tails(fitted.pick(again), looks, width_px, choices) if len(again) else []
    return out


def _fitted_with_tails(fitted: FittedEdges, looks: FirstLooks, width_px: Float, choices: Choices) -> list[FittedEdges]:
    """The fits again, with samples restored from the fits before."""
    todo = [fitted]
    for _ in range(STEPS):
        done = []
        for part in todo:
            asked = part.places
            for new in _fitted_as_is(restored(part), looks.pick(asked), width_px[asked], choices.pick(asked)):
                done.append(replace(new, places=asked[new.places]))
        todo = done
    return todo


def _fitted_as_is(stack: Stack, looks: FirstLooks, width_px: Float, choices: Choices) -> list[FittedEdges]:
    """Fitted edges; none of a region whose equations have no solution."""
    try:
        return measure_edges(stack, looks, width_px, floor=ROUNDING_VARIANCE, choices=choices)
    except np.linalg.LinAlgError:
        if len(stack) == 1:
            return []
    out = []
    for i in range(len(stack)):
        one = np.array([i])
        for fitted in _fitted_as_is(stack.pick(one), looks.pick(one), width_px[one], choices.pick(one)):
            out.append(replace(fitted, places=one))
    return out


def _saturated(samples: Samples) -> dict[str, str]:
    share = float(samples.clipped_high.mean())
    return {"saturated": f"{100 * share:.0f} % of the region is at the white level; expose less"} if share > 0.3 else {}
