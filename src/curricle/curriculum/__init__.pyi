from .curriculum import Curriculum as Curriculum
from .result import CurriculumResult as CurriculumResult, SourceValues as SourceValues
