from .arms import Unit as Unit, train_unit as train_unit
from .config.reading import read_study as read_study
from .config.study_config import StudyConfig as StudyConfig
from .progress import Progress as Progress
from .results import StudyResults as StudyResults, compare_studies as compare_studies
from .running import merge as merge, run_study as run_study
from .store import StudyStore as StudyStore
from .study_arguments import compare as compare, forecast as forecast
from .workers import WorkerProcesses as WorkerProcesses
