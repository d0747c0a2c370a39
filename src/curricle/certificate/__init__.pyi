from .certification import certify as certify
from .given import ShapingReward as ShapingReward
from .verdict import Certificate as Certificate, Counterexample as Counterexample
