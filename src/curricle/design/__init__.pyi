from . import designers as designers
from .arms import first_arms as first_arms, variations as variations
from .assembly import TARGET as TARGET, transfers_of as transfers_of
from .bottlenecks import betweenness as betweenness
from .break_even import BreakEven as BreakEven
from .candidates import (
    SourceCandidates as SourceCandidates,
    source_candidates as source_candidates,
)
from .judgement import Judgement as Judgement, judge as judge
from .ledger import CLASSES as CLASSES, COMPUTATIONS as COMPUTATIONS, Ledger as Ledger
from .makers import KINDS as KINDS
from .problem import Problem as Problem, Training as Training
from .proposals import SourceCandidate as SourceCandidate
from .racing import Race as Race, Round as Round, race as race
from .recipe import Recipe as Recipe, Stage as Stage
from .recipe_design import RecipeDesign as RecipeDesign, design_recipe as design_recipe
from .relations import Relation as Relation
from .search_budget import BudgetSpent as BudgetSpent, SearchBudget as SearchBudget
from .spending import ledger_of as ledger_of
from .standing import STANDING as STANDING, standing_recipe as standing_recipe
from .target_design import TargetDesign as TargetDesign, design_curriculum as design_curriculum
from .timed_problems import timed as timed
from .trends import Trend as Trend
