from .arms import Unit as Unit, train_unit as train_unit
from .auditing import Audit as Audit, audit as audit
from .config import (
    StudyConfig as StudyConfig,
    compare as compare,
    forecast as forecast,
    read_study as read_study,
)
from .results import StudyResults as StudyResults, compare_studies as compare_studies
from .running import Progress as Progress, merge as merge, run_study as run_study
from .store import StudyStore as StudyStore
from .templates import new_study as new_study
from .tuning import choose as choose
from .workers import WorkerProcesses as WorkerProcesses
