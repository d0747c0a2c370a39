from .curriculum import Curriculum as Curriculum
from .node import Node as Node
from .result import CurriculumResult as CurriculumResult
from .sources import SourceValues as SourceValues
