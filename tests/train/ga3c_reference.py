"""GA3C's update in NumPy, from its description: one trajectory, one step of TensorFlow's RMSProp.

Babaeizadeh et al. 2016, and Mnih et al. 2016 for the loss: sums over the steps of
-log max(pi(a), 1e-6) (R - V), of (R - V)^2 / 2, and of -beta H. The policy is the paper's tree, branch and
leaf, epsilon mixed in at both. Gradients are worked out by hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST = 1e-6


@dataclass
class Trajectory:
    """Steps of one episode, at most `T_MAX`, and the value of what comes after: 0 if the episode ended."""

    x: Array  # (n, inputs)
    target: Array  # (n, 5), joined before the heads
    legal: NDArray[np.bool_]  # (n, actions)
    actions: NDArray[np.int64]  # (n,)
    rewards: Array  # (n,)
    after: float


class Reference:
    """One hidden layer, a tree of answers and moves, a value; parameters by name as PyTorch has them."""

    def __init__(
        self,
        parameters: dict[str, Array],
        classes: int,
        *,
        rate: float,
        gamma: float,
        beta: float,
        epsilon: float,
    ) -> None:
        self.p = {name: value.copy() for name, value in parameters.items()}
        self.square = {name: np.ones_like(value) for name, value in parameters.items()}
        self.classes, self.rate, self.gamma = classes, rate, gamma
        self.beta, self.epsilon = beta, epsilon

    def update(self, one: Trajectory, eps: float = 0.1, decay: float = 0.99) -> None:
        gradient = self.gradient(one)
        for name, g in gradient.items():
            self.square[name] = decay * self.square[name] + (1 - decay) * g**2
            self.p[name] -= self.rate * g / np.sqrt(self.square[name] + eps)

    def returns(self, one: Trajectory) -> Array:
        found, after = np.empty(len(one.rewards)), one.after
        for t in range(len(found) - 1, -1, -1):
            after = np.clip(one.rewards[t], -1, 1) + self.gamma * after
            found[t] = after
        return found

    def gradient(self, one: Trajectory) -> dict[str, Array]:
        p = self.p
        hidden = one.x @ p["trunk.dense.weight"].T + p["trunk.dense.bias"]
        seen = np.concatenate([np.maximum(hidden, 0), one.target], 1)
        logits = seen @ p["policy.weight"].T + p["policy.bias"]
        value = (seen @ p["value.weight"].T + p["value.bias"])[:, 0]
        advantage = self.returns(one) - value
        d_logits = np.stack(
            [
                self.d_logits(row, legal, int(action), adv)
                for row, legal, action, adv in zip(logits, one.legal, one.actions, advantage, strict=True)
            ]
        )
        d_value = -advantage[:, None]
        d_hidden = (d_logits @ p["policy.weight"] + d_value @ p["value.weight"])[:, : hidden.shape[1]]
        d_hidden = d_hidden * (hidden > 0)
        return {
            "trunk.dense.weight": d_hidden.T @ one.x,
            "trunk.dense.bias": d_hidden.sum(0),
            "policy.weight": d_logits.T @ seen,
            "policy.bias": d_logits.sum(0),
            "value.weight": d_value.T @ seen,
            "value.bias": d_value.sum(0),
        }

    def d_logits(self, logits: Array, legal: NDArray[np.bool_], action: int, advantage: float) -> Array:
        """Of a step's -log max(pi(a), 1e-6) advantage - beta H; branches' logits first, then leaves'."""
        m = self.classes
        places = [slice(0, m), slice(m, len(legal))]
        open_ = np.array([legal[place].any() for place in places])
        branch, leaves = softmax(logits[:2], open_), [softmax(logits[2:][s], legal[s]) for s in places]
        b = int(action >= m)
        leaf = action - places[b].start
        acting_branch = (1 - self.epsilon) * branch[b] + self.epsilon / open_.sum()
        acting_leaf = (1 - self.epsilon) * leaves[b][leaf] + self.epsilon / legal[places[b]].sum()
        d_branch, d_leaves = np.zeros(2), [np.zeros(len(x)) for x in leaves]
        if acting_branch * acting_leaf > LEAST:
            share = (1 - self.epsilon) * branch[b] / acting_branch
            d_branch -= advantage * share * (np.eye(2)[b] - branch)
            share = (1 - self.epsilon) * leaves[b][leaf] / acting_leaf
            d_leaves[b] -= advantage * share * (np.eye(len(leaves[b]))[leaf] - leaves[b])
        # The entropy of the whole policy is H(branch) + sum over branches of pi(branch) H(leaf).
        inner = np.array([entropy(x) for x in leaves])
        d_branch -= self.beta * branch * (inner - branch @ inner - log(branch) - entropy(branch))
        for i, x in enumerate(leaves):
            d_leaves[i] += self.beta * branch[i] * x * (log(x) + inner[i])
        return np.concatenate([d_branch, *d_leaves])


def softmax(logits: Array, legal: NDArray[np.bool_]) -> Array:
    if not legal.any():
        return np.zeros(len(logits))
    powers = np.where(legal, np.exp(logits - logits[legal].max()), 0.0)
    return powers / powers.sum()


def log(p: Array) -> Array:
    return np.log(np.where(p > 0, p, 1.0))


def entropy(p: Array) -> float:
    return float(-(p * log(p)).sum())
