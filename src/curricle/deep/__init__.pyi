from .learner import (
    DeepLearner as DeepLearner,
    PolicyReuse as PolicyReuse,
    WeightTransfer as WeightTransfer,
    residual_policy as residual_policy,
)
from .learning import (
    DeepResult as DeepResult,
    TrainedPolicy as TrainedPolicy,
    learn_deep as learn_deep,
)
from .miniature import miniatures as miniatures
from .networks import NetworkValues as NetworkValues, SmallCNN as SmallCNN
from .vec_env import ShapedVecEnv as ShapedVecEnv
