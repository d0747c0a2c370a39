from .teachers import (
    Episode as Episode,
    Learnability as Learnability,
    PrioritizedLevelReplay as PrioritizedLevelReplay,
    ReverseCurriculum as ReverseCurriculum,
    Teacher as Teacher,
    Uniform as Uniform,
)
from .teaching import TeachingResult as TeachingResult, teach as teach
