"""All designers by their names."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from curricle.curriculum.curriculum import Curriculum
from curricle.design.designers.baselines import no_curriculum, random_chain
from curricle.design.designers.chains_by_size import fixed_recipe, growing_chain
from curricle.design.designers.forward_search import beam, greedy_forward
from curricle.design.designers.heuristic_sequencing import hts_cr
from curricle.design.designers.object_similarity import object_oriented
from curricle.design.designers.transfer_potential import svetlik

Designer = Callable[..., Curriculum]

DESIGNERS: Mapping[str, Designer] = MappingProxyType(
    {
        "none": no_curriculum,
        "random": random_chain,
        "fixed_recipe": fixed_recipe,
        "growing_chain": growing_chain,
        "svetlik": svetlik,
        "object_oriented": object_oriented,
        "greedy_forward": greedy_forward,
        "beam": beam,
        "hts_cr": hts_cr,
    }
)
"""Designers by name: functions of a problem, candidates and a budget, and of a seed."""
