from .config.reading import read_study as read_study
from .config.study_config import StudyConfig as StudyConfig
from .config.study_tables import json_schema as json_schema
from .merging import merge as merge
from .playing import played_episode as played_episode, stored_episode as stored_episode
from .progress import Progress as Progress
from .results import StudyResults as StudyResults, compare_studies as compare_studies
from .running import run_study as run_study
from .store import StudyStore as StudyStore
from .study_arguments import compare as compare, forecast as forecast
from .units import Unit as Unit, UnitInput as UnitInput, train_unit as train_unit
from .workers import WorkerProcesses as WorkerProcesses
