from .certification import certify as certify
from .shaped_task import ShapingReward as ShapingReward
from .verdict import (
    Certificate as Certificate,
    Counterexample as Counterexample,
    SampledCertificate as SampledCertificate,
)
