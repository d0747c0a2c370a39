from .agents import AgentsVecEnv as AgentsVecEnv
from .learner import DeepLearner as DeepLearner
from .learning import learn_deep as learn_deep
from .networks import NetworkValues as NetworkValues
from .residual import residual_policy as residual_policy
from .shaped import ShapedVecEnv as ShapedVecEnv
from .shaping import PolicyReuse as PolicyReuse, WeightTransfer as WeightTransfer
