from .certification import certify as certify
from .checked_shaping import ShapingReward as ShapingReward
from .verdict import (
    Certificate as Certificate,
    Counterexample as Counterexample,
    SampledCertificate as SampledCertificate,
)
