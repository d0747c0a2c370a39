from .assembly import TARGET as TARGET, transfers_of as transfers_of
from .bottlenecks import betweenness as betweenness
from .break_even import BreakEven as BreakEven
from .candidates import (
    SourceCandidates as SourceCandidates,
    source_candidates as source_candidates,
)
from .ledger import CLASSES as CLASSES, COMPUTATIONS as COMPUTATIONS, Ledger as Ledger
from .makers import KINDS as KINDS
from .problem import Problem as Problem, Training as Training
from .proposals import SourceCandidate as SourceCandidate
from .recipe import Recipe as Recipe, Stage as Stage
from .relations import Relation as Relation
from .search_budget import BudgetSpent as BudgetSpent, SearchBudget as SearchBudget
from .spending import ledger_of as ledger_of
from .trends import Trend as Trend
