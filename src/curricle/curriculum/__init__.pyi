from .curriculum import Curriculum as Curriculum, CurriculumResult as CurriculumResult
from .node import Node as Node
from .retraining import RetrainSources as RetrainSources
from .sources import SourceValues as SourceValues
