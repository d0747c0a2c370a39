"""Carts: the bins of a table, and a cart with a longer pole."""

import gymnasium as gym

from curricle.interop import Bins

BINS = Bins({
    "place": [-2.4, -0.8, 0.8, 2.4], "speed": [-3, -0.5, 0.5, 3],
    "angle": [-0.21, -0.1, -0.02, 0, 0.02, 0.1, 0.21], "spin": [-3, -0.87, -0.2, 0.2, 0.87, 3],
})  # fmt: skip
bins, many = BINS, BINS.many


def long_pole():
    """Return a cart whose pole is twice as long."""
    cart = gym.make("CartPole-v1")
    pole = cart.unwrapped
    pole.length *= 2
    pole.polemass_length *= 2
    return cart
