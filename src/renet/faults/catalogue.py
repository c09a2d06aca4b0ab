"""Table of all fault models."""

from renet.errors import demand_name
from renet.faults import (
    combined,
    image,
    physical,
    plausible,
    stereo,
    timing,
    vegetation,
    wet_floor,
)
from renet.faults.base import Fault

FAULTS: dict[str, type[Fault]] = {
    fault.name: fault
    for fault in (
        image.Gaussian, image.SaltAndPepper, image.Blackout, image.Saturated,
        timing.Frozen, timing.Dropped, timing.Latency,
        image.Occlusion, image.Blobs, image.Grass,
        image.Glare, image.GlareFilled, image.NearField,
        physical.Glass, physical.Foam, image.MotionBlur, physical.MountKnocked, image.WrongScale,
        timing.Unplugged,
        stereo.EdgeShadow, stereo.DisparitySteps, stereo.Textureless, vegetation.TallGrass,
        combined.GlareDropped, combined.BlobsLatency, combined.ShadowSteps,
        combined.IntermittentBlackout, combined.IntermittentFrozen, combined.IntermittentGlare,
        plausible.Mirrored, plausible.Turned, plausible.Split, plausible.HalfFrozen,
        plausible.TemporalFilter, plausible.GainDrift, plausible.WrapAround, plausible.Quantised,
        plausible.StrayLight, wet_floor.FloorReflection, wet_floor.WetPatch, physical.MountCreep,
    )
}  # fmt: skip


def fault_class(name: str) -> type[Fault]:
    """Return the fault model of a name; raises RenetError for an unknown one."""
    demand_name("fault", name, FAULTS)
    return FAULTS[name]
