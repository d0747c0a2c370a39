from .break_even import BreakEven as BreakEven
from .ledger import CLASSES as CLASSES, COMPUTATIONS as COMPUTATIONS, Ledger as Ledger
from .spending import ledger_of as ledger_of
