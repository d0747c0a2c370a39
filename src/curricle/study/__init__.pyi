from .config.document import Document as Document
from .config.reading import read_study as read_study
from .config.study_file import StudyFile as StudyFile
from .runner.merge import merge as merge
from .runner.run import Progress as Progress, run_study as run_study
from .runner.study import Study as Study, compared as compared
from .runner.unit import Unit as Unit, train_unit as train_unit
