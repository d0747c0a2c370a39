from .aggregate import maximum as maximum, mean as mean, minimum as minimum, total as total
from .bisimulation import by_homomorphism as by_homomorphism
from .by_components import (
    ComponentMapping as ComponentMapping,
    by_alignment as by_alignment,
    by_name as by_name,
    family_mappings as family_mappings,
    identity as identity,
    project as project,
    relative_objects as relative_objects,
    same_position as same_position,
)
from .mapping import (
    ENDED as ENDED,
    UNMAPPED as UNMAPPED,
    FunctionValues as FunctionValues,
    ObservationMapping as ObservationMapping,
    StateActionMapping as StateActionMapping,
    TableValues as TableValues,
    ValueSource as ValueSource,
    from_function as from_function,
)
from .pair import Proposal as Proposal, TaskPair as TaskPair
from .potential import ObservationPotential as ObservationPotential
from .search import (
    auto_mapping as auto_mapping,
    find_mappings as find_mappings,
    fitted_unmapped_value as fitted_unmapped_value,
    score_mapping as score_mapping,
)
from .transfer import Transfer as Transfer
