from .curriculum_callback import CurriculumCallback as CurriculumCallback
from .curriculum_vec_env import CurriculumVecEnv as CurriculumVecEnv
from .distillation import Distillation as Distillation
from .distilling import Distilled as Distilled, distil as distil
from .knowledge import Knowledge as Knowledge
from .learner import DeepLearner as DeepLearner
from .learning import learn_deep as learn_deep
from .miniature_task import Miniatures as Miniatures, miniatures as miniatures
from .networks import NetworkValues as NetworkValues
from .policy import TrainedPolicy as TrainedPolicy
from .residual import residual_policy as residual_policy
from .result import DeepResult as DeepResult
from .shaping import (
    Demonstrations as Demonstrations,
    PolicyReuse as PolicyReuse,
    WeightTransfer as WeightTransfer,
)
from .small_cnn import SmallCNN as SmallCNN
from .teaching import teach_deep as teach_deep
from .vec_env import AgentsVecEnv as AgentsVecEnv, ShapedVecEnv as ShapedVecEnv
