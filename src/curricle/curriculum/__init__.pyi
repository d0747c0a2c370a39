from .curriculum import Curriculum as Curriculum
from .result import CurriculumResult as CurriculumResult
from .sources import SourceValues as SourceValues
