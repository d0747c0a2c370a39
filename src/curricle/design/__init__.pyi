from .candidates import (
    SourceCandidates as SourceCandidates,
    source_candidates as source_candidates,
)
from .proposals import (
    SourceCandidate as SourceCandidate,
    mappings_between as mappings_between,
)
