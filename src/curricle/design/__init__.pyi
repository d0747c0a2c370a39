from .bottlenecks import betweenness as betweenness
from .break_even import BreakEven as BreakEven
from .candidates import (
    KINDS as KINDS,
    SourceCandidates as SourceCandidates,
    source_candidates as source_candidates,
)
from .ledger import CLASSES as CLASSES, COMPUTATIONS as COMPUTATIONS, Ledger as Ledger
from .proposals import SourceCandidate as SourceCandidate
from .spending import ledger_of as ledger_of
