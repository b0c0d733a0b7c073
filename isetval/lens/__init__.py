"""Lenses as ray-transfer functions: tracing, illumination, focus, PSF, diffraction, and an audit of lens files."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "LensAudit": "isetval.lens.audit_report",
    "Prescription": "isetval.lens.prescription",
    "RayTransferLens": "isetval.lens.ray_transfer",
    "audit": "isetval.lens.auditing",
    "audit_file": "isetval.lens.auditing",
    "combine": "isetval.lens.tracing",
    "default_lens": "isetval.lens.known_lenses",
    "from_rays": "isetval.lens.fit",
    "load_lens": "isetval.lens.transfer_file",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
