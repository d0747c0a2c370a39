from .baselines import no_curriculum as no_curriculum, random_chain as random_chain
from .by_name import DESIGNERS as DESIGNERS
from .chain_costs import ChainCosts as ChainCosts
from .chains_by_size import fixed_recipe as fixed_recipe, growing_chain as growing_chain
from .forward_search import beam as beam, greedy_forward as greedy_forward
from .heuristic_sequencing import hts_cr as hts_cr
from .object_similarity import object_oriented as object_oriented
from .source_settings import SourceSettings as SourceSettings
from .task_objects import objects_of as objects_of
from .transfer_potential import svetlik as svetlik, transfer_potential_of as transfer_potential_of
