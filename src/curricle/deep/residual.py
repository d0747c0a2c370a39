"""Networks started at a potential: the policy class for each algorithm."""

from curricle.errors import SettingError


def residual_policy(algorithm: type, policy: str = "MlpPolicy") -> type:
    """Return the policy class with which a network computes phi + a residual.

    The critic of PPO or A2C computes V(s) = Phi(s) + residual(s), and learns what it would learn
    from rewards shaped by Phi, which stay as they are. A network of DQN or QR-DQN computes
    phi(s, a) + residual(s, a). It acts, bootstraps and is evaluated on the sum, in the online and
    the target network alike. The residual starts at 0, and the potential is saved with the model.
    Among the ``policy_kwargs`` are

    - ``potential``, an :class:`ObservationPotential`;
    - ``reads``, of DQN and QR-DQN, which part of phi is an input of the residual beside the
      observation, standardised by the first batch it learns from: "actions", phi(s, .), the default
      for fewer than 32 actions; "state", Phi(s) = max_a phi(s, a), the default for more; or
      "nothing". A linear
      residual that reads nothing learns exactly what Q-learning from phi learns (Wiewiora 2003);
      but where phi jumps, as tables do between cells, a network of the observation alone cannot
      follow it, and may diverge.

    Parameters
    ----------
    algorithm : type
        DQN, QRDQN, PPO or A2C, or a class derived from one; others are refused with SettingError.
    policy : {"MlpPolicy", "CnnPolicy", "MultiInputPolicy"}

    Examples
    --------
    >>> from stable_baselines3 import DQN
    >>> from curricle import observation_task
    >>> from curricle.transfer import FunctionValues, ObservationPotential
    >>> car = observation_task("MountainCar-v0", discount=0.98)
    >>> push_along = FunctionValues(
    ...     lambda cars, actions: np.sign(cars[:, 1:]) * (actions - 1.0), actions=3)
    >>> phi = ObservationPotential.of(car, push_along)
    >>> model = DQN(residual_policy(DQN), "MountainCar-v0", gamma=0.98,
    ...             policy_kwargs={"potential": phi})
    >>> import numpy as np
    >>> model.predict(np.array([-0.5, 0.01], dtype=np.float32), deterministic=True)[0]
    array(2)
    """
    from curricle.deep import residual_critics, residual_networks

    known = residual_networks.POLICIES | residual_critics.POLICIES
    for kind in algorithm.__mro__:
        if (kind.__name__, policy) in known:
            return known[kind.__name__, policy]
    names = ", ".join(f"{name} with {policy}" for name, policy in known)
    raise SettingError(
        f"initialising a network needs one of {names}: got {algorithm.__name__} with {policy}; "
        "StateShaping serves every algorithm"
    )
