from .episode import Episode as Episode
from .exact_teachers import TrueLearningProgress as TrueLearningProgress, TrueRegret as TrueRegret
from .result import TeachingResult as TeachingResult
from .teachers import (
    TSCL as TSCL,
    Learnability as Learnability,
    PrioritizedLevelReplay as PrioritizedLevelReplay,
    ReverseCurriculum as ReverseCurriculum,
    Teacher as Teacher,
    Uniform as Uniform,
)
from .teaching import teach as teach
