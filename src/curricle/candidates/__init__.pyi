from .candidates import (
    SourceCandidate as SourceCandidate,
    SourceCandidates as SourceCandidates,
    source_candidates as source_candidates,
)
