from .aggregation import maximum as maximum, mean as mean, minimum as minimum, total as total
from .calibration import Calibration as Calibration, calibrate as calibrate
from .chosen_mapping import auto_mapping as auto_mapping
from .common_part import by_common_part as by_common_part
from .component_mapping import ComponentMapping as ComponentMapping, project as project
from .component_search import (
    by_alignment as by_alignment,
    by_assignment as by_assignment,
    by_name as by_name,
)
from .component_warping import by_component_warping as by_component_warping
from .coverage import Coverage as Coverage
from .edges import Calibrate as Calibrate, Transfer as Transfer
from .factored_homomorphisms import by_component_values as by_component_values
from .family_mapping import family_mappings as family_mappings
from .found_mappings import (
    FoundMapping as FoundMapping,
    FoundMappings as FoundMappings,
    find_mappings as find_mappings,
)
from .homomorphisms import by_homomorphism as by_homomorphism
from .identity_mapping import identity as identity
from .legs import by_legs as by_legs
from .mapping import (
    ENDED as ENDED,
    UNMAPPED as UNMAPPED,
    StateActionMapping as StateActionMapping,
    compose as compose,
    from_function as from_function,
    relative_objects as relative_objects,
    same_position as same_position,
)
from .mapping_scores import MappingScores as MappingScores, score_mapping as score_mapping
from .mapping_search import Projection as Projection, find_projections as find_projections
from .nearest_pairs import (
    LaxBisimulation as LaxBisimulation,
    by_lax_bisimulation as by_lax_bisimulation,
    lax_bisimulation as lax_bisimulation,
)
from .observation_mapping import (
    ObservationCoverage as ObservationCoverage,
    ObservationMapping as ObservationMapping,
)
from .potentials import ObservationPotential as ObservationPotential
from .proposal import Proposal as Proposal
from .quality import PotentialQuality as PotentialQuality, potential_quality as potential_quality
from .structure_matching import by_structure as by_structure
from .task_pair import TaskPair as TaskPair
from .unmapped_values import fitted_unmapped_value as fitted_unmapped_value
from .value_sources import (
    FunctionValues as FunctionValues,
    TableValues as TableValues,
    ValueSource as ValueSource,
)
