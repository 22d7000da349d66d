"""Parts of rollouts."""

from __future__ import annotations

from dataclasses import fields, replace

from activelsd.policy.lsdnet import Output
from activelsd.train.rollout import Rollout

_BY_ROW = "bootstrap"  # (B,); all else is (L, B, ...), but for the state, (B, ...)


def columns(rollout: Rollout, place: slice) -> Rollout:
    """The rollout of some environments."""
    own = {}
    for field in fields(rollout):
        value = getattr(rollout, field.name)
        if field.name == _BY_ROW:
            own[field.name] = value[place]
        elif field.name == "observation":
            own[field.name] = {name: one[:, place] for name, one in value.items()}
        elif field.name == "state":
            own[field.name] = {name: one[place] for name, one in value.items()}
        elif field.name == "output" and value is not None:
            parts = (value.logits[:, place], value.value[:, place], value.features[:, place])
            own[field.name] = Output(*parts, {name: one[place] for name, one in value.state.items()})
        elif field.name not in ("epsilon", "output") and value is not None:
            own[field.name] = value[:, place]
    return replace(rollout, **own)
