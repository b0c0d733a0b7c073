"""The EMVA 1288 working group's descriptor file as a campaign: bright and dark series with stated photon numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Black, Exposure, Sensor, Window
from isetval.files.captures import FileCaptures
from isetval.files.emva_frames import FrameReader, black_dn, check_codes, deepest, found_frames, frame_of_level, looks_colored
from isetval.files.emva_lines import EmvaLines, read_emva_lines

FEWEST_OF_A_STACK = 8  # frames: levels have two, stacks for the spatial part sixteen and more (EMVA 1288 R4.0, 8.2)
F_NUMBER = 8.0  # of the standard's light: a disc seen under f/8 (EMVA 1288 R4.0, 6.1)
WAVELENGTH_NM, HALF_WIDTH_NM = 550.0, 5.0  # stands for the wavelength, which the format does not state
PLANCK_J_S, LIGHT_M_PER_S = 6.62607015e-34, 299_792_458.0
UNKNOWN_PITCH_UM = 1.0  # the format has no pitch; lengths in mm then mean thousands of pixels
LIGHT = "emva"


def load_emva_descriptor(path: Path | str, *, pixel_um: float = UNKNOWN_PITCH_UM, cfa: str = "MONO") -> Campaign:
    """A campaign of an EMVA 1288 descriptor file.

    Series become shots of role flat and dark, in the order of the file.  Stacks of eight and more frames, which the standard
    takes for the spatial part, are a measurement session of their own (``B``).  The sensor has the stated bits and size; its
    black level, which the format lacks, is the mean of the dark frames of the shortest exposure.

    Parameters
    ----------
    path : path
        The descriptor.
    pixel_um : float
        Pixel pitch, which the format lacks.
    cfa : str
        Pattern of the colours, which it lacks as well.

    Returns
    -------
    Campaign
        Flats state ``photons_per_pixel``.  Their light has the radiance that gives these photons to a pixel of ``pixel_um``
        through an ``aperture`` of f/8, at 550 nm; only the photon number is the laboratory's.

    Raises
    ------
    InputError
        For lines that are not of the format, paths that lead out of the folder, codes beyond the stated bits, and no usable
        dark series.
    """
    path = Path(path)
    found = read_emva_lines(path)
    files, moved = found_frames(path.parent, found.series)
    sensor = Sensor(*found.shape, pixel_um, cfa, _everywhere(0.0), 2.0**found.bits - 1, found.bits)
    shots = _shots(found, files, sensor)
    raw = FrameReader(path.parent, sensor, {shot.name: shot for shot in shots})
    black, remark = black_dn(raw, shots, path)
    check_codes(frame_of_level(deepest(raw), 1.0), found.bits, path)
    middle = frame_of_level(raw, 0.5)
    sensor = replace(sensor, black_dn=_everywhere(black))
    read = replace(raw, sensor=sensor)
    rates = [shot.photons_per_pixel / shot.exposure.time_s for shot in shots if shot.photons_per_pixel and shot.exposure.time_s]
    notes = (
        remark,
        f"the descriptor states no pixel pitch, {pixel_um:g} um is used; no wavelength, {WAVELENGTH_NM:g} nm stands for it; "
        "no error of its photon numbers: a nuisance light_level of scope campaign (isetval campaign init drafts it)",
        *filter(None, (moved, found.doubt(), looks_colored(middle, black) if middle is not None else "")),
    )
    return Campaign(
        name=path.resolve().parent.name,
        shots=shots,
        lights={LIGHT: Light(LIGHT, _spectrum(median(rates) if rates else 0.0, pixel_um))},
        sensor=sensor,
        folder=path.parent,
        provenance={"descriptor": path.name},
        captures=FileCaptures({shot.name: shot.files for shot in shots}, read, folder=path.parent),
        notes=notes,
    )


def _everywhere(black_dn: float) -> Black:
    return ((black_dn, black_dn), (black_dn, black_dn))


def _shots(found: EmvaLines, files: list[tuple[str, ...]], sensor: Sensor) -> tuple[Shot, ...]:
    rates = [s.photons / s.time_s for s in found.series if s.photons and s.time_s]
    unit = median(rates) if rates else 1.0
    numbers = dict.fromkeys(("dark", "flat", "dark_stack", "flat_stack"), 0)
    shots = []
    for series, names in zip(found.series, files, strict=True):
        stack = len(names) >= FEWEST_OF_A_STACK
        kind = series.role + ("_stack" if stack else "")
        lit = series.photons is not None
        rate = series.photons / series.time_s if series.photons and series.time_s else 0.0
        shots.append(
            Shot(
                name=f"{kind}_{numbers[kind]:03d}",
                role=series.role,
                setup=series.role,
                measurement_session="B" if stack else "A",
                exposure=Exposure(series.time_s or None),
                frames=len(names),
                light=LIGHT if lit else None,
                light_level=rate / unit if lit else 1.0,
                window=Window(0, 0, sensor.rows, sensor.cols),
                files=names,
                photons_per_pixel=series.photons,
            )
        )
        numbers[kind] += 1
    return tuple(shots)


def _spectrum(photons_per_s: float, pixel_um: float) -> Spectrum:
    """Radiance in W/(sr m2 nm), a narrow band, that sends so many photons a second to a pixel behind f/8: E = pi L / (4 N^2)."""
    joule = PLANCK_J_S * LIGHT_M_PER_S / (WAVELENGTH_NM * 1e-9)
    irradiance = photons_per_s * joule / (pixel_um * 1e-6) ** 2
    peak = irradiance * 4 * F_NUMBER**2 / math.pi / HALF_WIDTH_NM
    band = np.array([WAVELENGTH_NM - HALF_WIDTH_NM, WAVELENGTH_NM, WAVELENGTH_NM + HALF_WIDTH_NM])
    return Spectrum(band, np.array([0.0, peak, 0.0]))
