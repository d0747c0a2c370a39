from .choice import Choice as Choice, choose as choose
from .comparison import Comparison as Comparison, compare as compare
from .forecasting import (
    Forecast as Forecast,
    forecast as forecast,
    source_learning as source_learning,
)
from .measures import Arm as Arm, Contrast as Contrast, Reference as Reference
from .task_differences import differences as differences
from .verdicts import Verdict as Verdict, seeds_needed as seeds_needed, verdicts_of as verdicts_of
