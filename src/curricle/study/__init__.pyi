from .arms import Unit as Unit, train_unit as train_unit
from .choosing import choose as choose
from .config import (
    StudyConfig as StudyConfig,
    compare as compare,
    forecast as forecast,
    read_study as read_study,
)
from .progress import Progress as Progress
from .results import StudyResults as StudyResults, compare_studies as compare_studies
from .running import merge as merge, run_study as run_study
from .store import StudyStore as StudyStore
from .workers import WorkerProcesses as WorkerProcesses
