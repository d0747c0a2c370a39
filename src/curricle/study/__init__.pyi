from .config.reading import read_study as read_study
from .config.study_config import StudyConfig as StudyConfig
from .config.study_tables import json_schema as json_schema
from .results import StudyResults as StudyResults, compare_studies as compare_studies
from .running import Progress as Progress, merge as merge, run_study as run_study
from .store import StudyStore as StudyStore
from .units import Unit as Unit, UnitInput as UnitInput, train_unit as train_unit
from .workers import WorkerProcesses as WorkerProcesses
