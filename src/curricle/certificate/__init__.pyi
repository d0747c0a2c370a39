from .certification import (
    Certificate as Certificate,
    Counterexample as Counterexample,
    certify as certify,
)
from .shaped_task import ShapingReward as ShapingReward
