from .learner import DeepLearner as DeepLearner
from .learning import learn_deep as learn_deep
from .miniature import miniatures as miniatures
from .networks import NetworkValues as NetworkValues, SmallCNN as SmallCNN
from .policy import DeepResult as DeepResult, TrainedPolicy as TrainedPolicy
from .shaping import (
    PolicyReuse as PolicyReuse,
    WeightTransfer as WeightTransfer,
    residual_policy as residual_policy,
)
from .vec_env import ShapedVecEnv as ShapedVecEnv
