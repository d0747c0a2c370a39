from .certification import certify as certify
from .verdict import Certificate as Certificate, Counterexample as Counterexample
